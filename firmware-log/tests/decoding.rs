//! Tests of the decoder with frames of a small image that has a table of messages.

use firmware_log::{Decoder, Error, Level, rtt_control_block};
use object::write::{Object, Symbol, SymbolSection};
use object::{Architecture, BinaryFormat, Endianness, SectionKind, SymbolFlags, SymbolKind, SymbolScope};
use proptest::prelude::*;

const RTT: u64 = 0x2000_0100;

/// Returns an image with these messages (address, tag and text) as symbols in its section `.defmt`, and with the symbols
/// `marks`, which give version and encoding of the log.
fn image(messages: &[(u64, &str, &str)], marks: &[&str]) -> Vec<u8> {
    let mut elf = Object::new(BinaryFormat::Elf, Architecture::Arm, Endianness::Little);
    let section = elf.add_section(Vec::new(), b".defmt".to_vec(), SectionKind::Other);
    elf.append_section_data(section, &[0; 64], 1);
    let mut add = |name: String, value, section| {
        let (kind, scope) = (SymbolKind::Data, SymbolScope::Linkage);
        let (size, weak, flags) = (1, false, SymbolFlags::None);
        elf.add_symbol(Symbol { name: name.into(), value, size, kind, scope, weak, section, flags });
    };
    for (at, tag, text) in messages {
        let name = format!(
            r#"{{"package":"p","tag":"{tag}","data":"{text}","disambiguator":"{at}","crate_name":"c"}}"#
        );
        add(name, *at, SymbolSection::Section(section));
    }
    for mark in marks {
        add((*mark).into(), 0, SymbolSection::Absolute);
    }
    add("_SEGGER_RTT".into(), RTT, SymbolSection::Absolute);
    elf.write().unwrap()
}

const MARKS: [&str; 2] = ["_defmt_version_ = 4", "_defmt_encoding_ = rzcobs"];
const MESSAGES: [(u64, &str, &str); 6] = [
    (1, "defmt_info", "kestrel {=str}"),
    (2, "defmt_warn", "late: {=u32:b}"),
    (3, "defmt_error", "it is over"),
    (4, "defmt_println", "plain {=i16}"),
    (5, "defmt_debug", "{=istr} {=bool}"),
    (6, "defmt_timestamp", "{=u32:us}"),
];

/// Encodes a frame by <https://github.com/Dirbaio/rzcobs> in its simplest form: groups of seven bytes without their zeros,
/// each followed by a byte that marks the zeros.
fn encode(frame: &[u8]) -> Vec<u8> {
    let mut padded = frame.to_vec();
    padded.resize(frame.len().next_multiple_of(7), 0);
    let mut bytes = Vec::new();
    for group in padded.chunks(7) {
        bytes.extend(group.iter().filter(|&&byte| byte != 0));
        let mark = group.iter().enumerate().fold(0, |mark, (n, &byte)| mark | u8::from(byte == 0) << n);
        // A group without a zero needs another mark, which these tests do not use.
        assert_ne!(mark, 0, "a group without a zero");
        bytes.push(mark);
    }
    bytes.push(0);
    bytes
}

fn frame(index: u16, time_us: u32, arguments: &[u8]) -> Vec<u8> {
    encode(&[&index.to_le_bytes()[..], &time_us.to_le_bytes(), arguments].concat())
}

#[test]
fn frames_decode_to_lines_with_time_and_level() {
    let mut decoder = Decoder::new(&image(&MESSAGES, &MARKS)).unwrap();
    let mut bytes = frame(1, 0, &[3, 0, 0, 0, b'a', b'b', b'c']);
    bytes.extend(frame(2, 1_500_000, &[5, 0, 0, 0]));
    bytes.extend(frame(3, 2_000_001, &[]));
    bytes.extend(frame(4, 65_536, &[0xfe, 0xff]));
    let lines = decoder.push(&bytes);
    let as_text: Vec<String> = lines.iter().map(ToString::to_string).collect();
    assert_eq!(
        as_text,
        [
            "    0.000000 info  kestrel abc",
            "    1.500000 warn  late: 101",
            "    2.000001 error it is over",
            "    0.065536       plain -2",
        ]
    );
    assert_eq!((lines[1].time_us, lines[1].level), (Some(1_500_000), Some(Level::Warn)));
    assert_eq!(decoder.damaged(), 0);
}

#[test]
fn frame_in_pieces_is_decoded() {
    let bytes = frame(2, 7, &[1, 0, 0, 0]);
    let mut decoder = Decoder::new(&image(&MESSAGES, &MARKS)).unwrap();
    let (last, before) = bytes.split_last().unwrap();
    for byte in before {
        assert_eq!(decoder.push(&[*byte]), []);
    }
    assert_eq!(decoder.push(&[*last])[0].message, "late: 1");
    assert_eq!(decoder.push(&[0, 0, 0]), []);
}

#[test]
fn damaged_frame_gives_a_line_and_next_is_decoded() {
    let mut decoder = Decoder::new(&image(&MESSAGES, &MARKS)).unwrap();
    let mut bytes = frame(99, 7, &[]);
    bytes.extend(frame(3, 8, &[]));
    let lines = decoder.push(&bytes);
    assert_eq!(lines[0].message, "damaged frame of 3 bytes");
    assert_eq!((lines[0].time_us, lines[0].level), (None, None));
    assert_eq!(lines[1].message, "it is over");
    assert_eq!(decoder.damaged(), 1);
}

#[test]
fn image_without_log_is_refused() {
    let refused = |elf: &[u8]| Decoder::new(elf).unwrap_err();
    assert!(matches!(refused(b"no image"), Error::Unreadable(_)));
    assert!(refused(&image(&MESSAGES, &[])).to_string().contains("no defmt version symbol"));
    assert!(refused(&image(&MESSAGES, &["_defmt_version_ = 9", MARKS[1]])).to_string().contains("using 9"));
    assert_eq!(refused(&image(&[], &MARKS)), Error::NoLog);
    assert_eq!(refused(&image(&MESSAGES, &[MARKS[0], "_defmt_encoding_ = raw"])), Error::Encoding);
}

#[test]
fn control_block_is_found_by_its_symbol() {
    assert_eq!(rtt_control_block(&image(&MESSAGES, &MARKS)), Some(RTT as u32));
    assert_eq!(rtt_control_block(b"no image"), None);
}

proptest! {
    #[test]
    fn any_bytes_give_lines(pieces: Vec<Vec<u8>>, index in 0_u8..8) {
        let mut decoder = Decoder::new(&image(&MESSAGES, &MARKS)).unwrap();
        for piece in &pieces {
            decoder.push(piece);
            // The same bytes are also the arguments of a known message.
            let arguments: Vec<u8> = piece.iter().flat_map(|&byte| [byte, 0]).collect();
            decoder.push(&frame(u16::from(index), 0, &arguments));
        }
    }
}
