//! The contents of a linked image: functions, their bytes, and the vector table.

use std::collections::BTreeMap;
use std::path::Path;

use object::{Object as _, ObjectSection as _, ObjectSymbol as _, SymbolKind};

pub struct Image {
    pub functions: BTreeMap<u32, Symbol>,
    /// The contents of flash without the vector table, by address.
    sections: BTreeMap<u32, Vec<u8>>,
    /// Addresses where code (`true`) or data (`false`) begins, by the ELF's mapping symbols.
    mapping: BTreeMap<u32, bool>,
    /// The vector table from the second word on: the handlers of reset, faults and interrupts.
    pub vectors: Vec<u32>,
    /// Size of the stack, bytes: `STACK` of memory.x.
    pub stack_bytes: u32,
    /// Size of what is flashed, bytes: vectors, code, constants, and the initial values of variables.
    pub flash_bytes: u32,
    /// Size of the variables in RAM, bytes.
    pub ram_bytes: u32,
}

pub struct Symbol {
    /// All names at this address, aliases last.
    pub names: Vec<String>,
    pub size: u32,
}

impl Image {
    pub fn read(path: &Path) -> Self {
        let bytes = std::fs::read(path).unwrap();
        let elf = object::File::parse(&*bytes).unwrap();
        let bytes_of = |name| elf.section_by_name(name).unwrap().data().unwrap().to_vec();
        let size_of = |name| elf.section_by_name(name).map_or(0, |section| section.size() as u32);
        let address_of = |name| elf.section_by_name(name).unwrap().address() as u32;
        let mut functions: BTreeMap<u32, Symbol> = BTreeMap::new();
        let mut mapping = BTreeMap::from([".rodata", ".data"].map(|name| (address_of(name), false)));
        let mut stack = BTreeMap::new();
        for symbol in elf.symbols() {
            let (name, address) = (symbol.name().unwrap(), symbol.address() as u32);
            match name.split('.').next().unwrap() {
                kind @ ("$t" | "$d") => {
                    let before = mapping.insert(address, kind == "$t");
                    assert!(
                        before.is_none_or(|before| before == (kind == "$t")),
                        "{address:#x}: code or data?"
                    );
                }
                "$a" => panic!("{address:#x}: ARM code"),
                "_stack_start" | "_stack_end" => {
                    stack.insert(name.to_owned(), address);
                }
                _ if symbol.kind() == SymbolKind::Text => {
                    let names = Vec::new();
                    let function = functions.entry(address & !1).or_insert(Symbol { names, size: 0 });
                    let name = format!("{:#}", rustc_demangle::demangle(name));
                    // An alias from the linker script has no size.
                    let at = if symbol.size() > 0 { 0 } else { function.names.len() };
                    function.names.insert(at, name);
                    function.size = function.size.max(symbol.size() as u32);
                }
                _ => {}
            }
        }
        let table = bytes_of(".vector_table");
        let mut words = table.as_chunks().0.iter().map(|word| u32::from_le_bytes(*word));
        assert_eq!(words.next(), Some(stack["_stack_start"]), "the vector table's first word");
        Self {
            functions,
            sections: [".text", ".rodata", ".data"].map(|name| (address_of(name), bytes_of(name))).into(),
            mapping,
            vectors: words.filter(|&handler| handler != 0).map(|handler| handler & !1).collect(),
            stack_bytes: stack["_stack_start"] - stack["_stack_end"],
            flash_bytes: [".vector_table", ".text", ".rodata", ".data"].map(size_of).iter().sum(),
            ram_bytes: [".data", ".bss", ".uninit"].map(size_of).iter().sum(),
        }
    }

    /// Creates an image of these functions, one after the other from address 0.
    pub fn of(functions: &[(&str, &[u16])]) -> Self {
        let mut image = Self {
            functions: BTreeMap::new(),
            sections: BTreeMap::new(),
            mapping: [(0, true)].into(),
            vectors: Vec::new(),
            stack_bytes: 0,
            flash_bytes: 0,
            ram_bytes: 0,
        };
        let mut bytes = Vec::new();
        for (name, code) in functions {
            let symbol = Symbol { names: vec![(*name).to_owned()], size: 2 * code.len() as u32 };
            image.functions.insert(bytes.len() as u32, symbol);
            bytes.extend(code.iter().flat_map(|half_word| half_word.to_le_bytes()));
        }
        image.sections.insert(0, bytes);
        image
    }

    /// Marks bytes of an image made by [`Self::of`] as data.
    pub fn with_data(mut self, range: std::ops::Range<u32>) -> Self {
        self.mapping.extend([(range.start, false), (range.end, true)]);
        self
    }

    /// Returns the address of the function with this name.
    pub fn find(&self, name: &str) -> Option<u32> {
        let mut named = self.functions.iter().filter(|(_, symbol)| symbol.names.iter().any(|n| n == name));
        named.next().map(|(&address, _)| address)
    }

    pub fn name(&self, function: u32) -> &str {
        &self.functions[&function].names[0]
    }

    pub fn byte(&self, address: u32) -> Option<u8> {
        let (&start, bytes) = self.sections.range(..=address).next_back()?;
        bytes.get((address - start) as usize).copied()
    }

    pub fn half_word(&self, address: u32) -> Option<u16> {
        Some(u16::from_le_bytes([self.byte(address)?, self.byte(address + 1)?]))
    }

    pub fn is_code(&self, address: u32) -> bool {
        self.mapping.range(..=address).next_back().is_some_and(|(_, &code)| code)
    }

    /// Returns every aligned word that is data: tables, literals, initial values of variables.
    pub fn data_words(&self) -> impl Iterator<Item = u32> {
        self.sections.iter().flat_map(move |(&start, bytes)| {
            bytes.as_chunks().0.iter().zip((start..).step_by(4)).filter_map(move |(word, address)| {
                let is_data = !self.is_code(address) || !self.is_code(address + 2);
                is_data.then(|| u32::from_le_bytes(*word))
            })
        })
    }
}
