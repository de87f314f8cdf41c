use super::*;
use crate::flight::Crash;
use crate::output_file::OutputFile;
use std::path::{Path, PathBuf};

/// A scene of 0.05 s on the bench, with a drawn vehicle.
fn scene() -> Scene {
    let text = "include = \"static\"\n[scene]\nduration_s = 0.05\nseed = 18446744073709\n[tolerances]\n\
                mass_kg = { uniform_percent = 5 }\nmag_hard_iron_ut = { normal = 2 }\n";
    Scene::parse("bench", text).unwrap()
}

fn flown(campaign: &Campaign, shard: Shard, jobs: usize) -> Vec<Run> {
    let jobs = NonZeroUsize::new(jobs).unwrap();
    fly(&scene(), campaign, shard.runs(campaign.runs), jobs, &AtomicBool::new(false), &|| ())
}

fn written(path: &Path, campaign: &Campaign, runs: &[Run]) -> PathBuf {
    write(OutputFile::create(path).unwrap(), campaign, runs).unwrap();
    path.into()
}

#[test]
fn shards_cover_each_run_once_and_differ_by_at_most_one() {
    for runs in [1, 2, 7, 8, 1000, u64::MAX] {
        for parts in [1, 2, 3, 7] {
            let mut end = 0;
            let (mut min, mut max) = (u64::MAX, 0);
            for part in 1..=parts {
                let shard: Shard = format!("{part}/{parts}").parse().unwrap();
                let range = shard.runs(runs);
                assert_eq!(range.start, end);
                (min, max) = (min.min(range.end - range.start), max.max(range.end - range.start));
                end = range.end;
            }
            assert!(end == runs && max - min <= 1, "{runs} in {parts}");
        }
    }
    for wrong in ["", "1", "0/3", "4/3", "1/0", "-1/3", "1/3/3", "one/three", "1.0/3"] {
        assert!(wrong.parse::<Shard>().is_err(), "{wrong}");
    }
}

#[test]
fn jobs_shards_and_their_order_do_not_change_the_file() {
    let directory = tempfile::tempdir().unwrap();
    let file = |name: &str| directory.path().join(name);
    let campaign = Campaign::new(&scene(), 11);
    let whole = written(&file("whole.csv"), &campaign, &flown(&campaign, Shard::ALL, 1));
    let threads = written(&file("threads.csv"), &campaign, &flown(&campaign, Shard::ALL, 4));
    let parts = [2, 3, 1].map(|part| {
        let shard = format!("{part}/3").parse().unwrap();
        written(&file(&format!("{part}.csv")), &campaign, &flown(&campaign, shard, 2))
    });
    let (read, runs) = merge(&parts).unwrap();
    assert_eq!(read, campaign);
    assert_eq!(runs, flown(&campaign, Shard::ALL, 3));
    let merged = written(&file("merged.csv"), &read, &runs);
    let bytes = |path: &Path| std::fs::read(path).unwrap();
    assert_eq!(bytes(&threads), bytes(&whole));
    assert_eq!(bytes(&merged), bytes(&whole));
    assert_eq!(
        Summary::new(&read, &runs).to_json(),
        Summary::new(&campaign, &flown(&campaign, Shard::ALL, 1)).to_json()
    );
}

#[test]
fn crashes_and_large_values_survive_the_file() {
    let campaign = Campaign { scene: "a, \"b\"".into(), ..Campaign::new(&scene(), 7) };
    let mut runs = flown(&campaign, Shard::ALL, 1);
    for (run, crash) in runs.iter_mut().zip(Crash::ALL) {
        run.outcome.crash = Some((crash, 0.01 + 0.02));
        run.outcome.position_error_max_m = f64::MAX;
    }
    let directory = tempfile::tempdir().unwrap();
    let path = written(&directory.path().join("a.csv"), &campaign, &runs);
    assert_eq!(merge(&[path]).unwrap(), (campaign, runs));
}

#[test]
fn files_that_do_not_make_one_campaign_are_refused() {
    let directory = tempfile::tempdir().unwrap();
    let campaign = Campaign::new(&scene(), 10);
    let runs = flown(&campaign, Shard::ALL, 2);
    let part =
        |name: &str, campaign: &Campaign, runs: &[Run]| written(&directory.path().join(name), campaign, runs);
    let first = part("first.csv", &campaign, &runs[..4]);
    let last = part("last.csv", &campaign, &runs[6..]);
    let error_of = |parts: &[&PathBuf]| {
        let parts: Vec<PathBuf> = parts.iter().map(|part| (*part).clone()).collect();
        let error = merge(&parts).unwrap_err().to_string();
        error.replace(&format!("{}/", directory.path().display()), "")
    };
    assert_eq!(
        error_of(&[&last, &first]),
        "PART: must include runs 4 to 5 of 10: the file of a shard is missing"
    );
    assert_eq!(error_of(&[&first]), "PART: must include runs 4 to 9 of 10: the file of a shard is missing");
    assert_eq!(error_of(&[&last]), "PART: must include runs 0 to 5 of 10: the file of a shard is missing");
    let middle = part("middle.csv", &campaign, &runs[5..6]);
    assert_eq!(
        error_of(&[&middle, &last]),
        "PART: must include runs 0 to 4 of 10: the file of a shard is missing"
    );
    assert_eq!(
        error_of(&[&middle]),
        "PART: must include runs 0 to 4 of 10, and 4 more: the file of a shard is missing"
    );
    assert_eq!(
        error_of(&[&first, &last, &first]),
        "first.csv:2: run = 0: must be in one file only: first.csv has it too"
    );
    let again = part("again.csv", &campaign, &runs[3..6]);
    assert_eq!(
        error_of(&[&first, &again, &last]),
        "again.csv:2: run = 3: must be in one file only: first.csv has it too"
    );

    let foreign = |change: fn(&mut Campaign)| {
        let mut foreign = campaign.clone();
        change(&mut foreign);
        let part = part("foreign.csv", &foreign, &runs[4..6]);
        error_of(&[&first, &part, &last])
    };
    for (change, wanted) in [
        ((|c| c.scene = "hover".into()) as fn(&mut Campaign), "scene = hover: must be the scene"),
        (|c| c.scene_hash = 1, "scene_hash = 0000000000000001: must be the text of the scene"),
        (|c| c.version = "9.9.9".into(), "version = 9.9.9: must be the version of sim-host"),
        (|c| c.duration_s = 2.0, "duration_s = 2: must be the length of the flights"),
        (|c| c.first_seed = 5, "first_seed = 5: must be the first seed"),
        (|c| c.runs = 12, "runs = 12: must be the number of runs"),
    ] {
        let wanted = format!("foreign.csv:2: {wanted} of first.csv: both files must be of one campaign");
        assert_eq!(foreign(change), wanted);
    }

    let altered = |from: &str, to: &str| {
        let text = std::fs::read_to_string(&first).unwrap();
        assert!(text.contains(from), "{text}");
        let path = directory.path().join("altered.csv");
        std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
        error_of(&[&path])
    };
    assert_eq!(
        altered("attitude_rmse_deg", "rmse"),
        "altered.csv:1: column 13 = rmse: must be attitude_rmse_deg, as in results of `fly --out`"
    );
    assert_eq!(
        altered(",10,0,18446744073709,", ",10,0,1,"),
        "altered.csv:2: seed = 1: must be 18446744073709, the sum of first seed and run"
    );
    assert_eq!(altered(",10,3,", ",10,30,"), "altered.csv:5: run = 30: must be a whole number from 0 to 9");
    assert!(
        altered("Disarmed", "Disarmd").starts_with("altered.csv:2: final_state = Disarmd: must be one of")
    );
    assert!(altered(",50,", ",50.5,").contains("control_steps = 50.5: must be a whole number"));
    assert!(
        altered(",50,", ",18446744073709551615,")
            .contains("control_steps = 18446744073709551615: must be a whole number from 1 to 50")
    );
    assert!(altered(",50,", ",0,").ends_with(": control_steps = 0: must be a whole number from 1 to 50"));
    assert!(
        altered(",0.05,", ",NaN,").ends_with("duration_s = NaN: must be a number from 0.01 to 1000000 s")
    );
    assert!(
        altered(",,,", ",,0.02,").ends_with("crashed_at_s = 0.02: must be empty in a run without a crash")
    );
    for at_s in ["-1", "inf", "0.051", ""] {
        let error = altered(",,,", &format!(",tipped_over,{at_s},"));
        assert!(
            error.contains(": crashed_at_s = ") && error.ends_with("must be a number from 0 to 0.05 s"),
            "{error}"
        );
    }
    let hash = format!("{:016x}", campaign.scene_hash);
    for wrong in ["1", "+123456789abcdef", "00123456789abcdef", "0x23456789abcdef"] {
        let wanted = format!("altered.csv:2: scene_hash = {wrong}: must be 16 hexadecimal digits");
        assert_eq!(altered(&hash, wrong), wanted);
    }
    let digest = format!("{:016x}", runs[0].outcome.digest);
    assert_eq!(altered(&digest, "1"), "altered.csv:2: digest = 1: must be 16 hexadecimal digits");
    let rmse = format!(",{},", runs[0].outcome.attitude_rmse_deg);
    for wrong in ["-0.5", "NaN", "inf", "x"] {
        let wanted = format!("altered.csv:2: attitude_rmse_deg = {wrong}: must be a number of at least 0");
        assert_eq!(altered(&rmse, &format!(",{wrong},")), wanted);
    }
    let last_seed = u64::MAX - 9;
    assert_eq!(
        altered(",18446744073709,10,", ",18446744073709551615,10,"),
        format!(
            "altered.csv:2: first_seed = 18446744073709551615: must be a whole number from 0 to {last_seed}"
        )
    );
    assert!(altered("drawn.mass_kg", "mass_kg").contains("must begin with drawn."));
    let empty = directory.path().join("empty.csv");
    std::fs::write(&empty, "").unwrap();
    assert_eq!(error_of(&[&empty]), "empty.csv: must be results of `fly --out`: the file is empty");
    assert!(error_of(&[&directory.path().join("nowhere.csv")]).starts_with("nowhere.csv: cannot be read: "));
    // A row that is cut off, for example by a full disk.
    let text = std::fs::read_to_string(&first).unwrap();
    std::fs::write(&empty, &text[..text.len() - 60]).unwrap();
    assert_eq!(error_of(&[&empty]), "empty.csv:5: number of cells = 21: must be 23, as in the header");
}

#[test]
fn worst_runs_are_sorted_and_crashes_listed_separately() {
    let campaign = Campaign::new(&scene(), 9);
    let mut runs = flown(&campaign, Shard::ALL, 2);
    for (i, run) in runs.iter_mut().enumerate() {
        run.outcome.attitude_rmse_deg = [3.0, 1.0, 4.0, 1.0, 5.0, 9.0, 2.0, 6.0, 5.0][i];
        run.outcome.tilt_max_deg = i as f64;
    }
    runs[5].outcome.crash = Some((Crash::TippedOver, 1.5));
    let summary = Summary::new(&campaign, &runs);
    let json = summary.to_json();
    let runs_of = |table: &str| -> Vec<u64> {
        let table = json["worst"][table].as_array().unwrap();
        table.iter().map(|run| run["seed"].as_u64().unwrap() - campaign.first_seed).collect()
    };
    assert_eq!(runs_of("crashes"), [5]);
    assert_eq!(runs_of("by_attitude_error"), [7, 4, 8, 2, 0]);
    assert_eq!(runs_of("by_tilt"), [8, 7, 6, 4, 3]);
    assert_eq!((summary.crashes(), json["crashed"].as_bool()), (1, Some(true)));
    // The errors in order are 9, 6, 5, 5, 4, 3, 2, 1, 1. The two values are the fifth of nine, and the ninth.
    assert_eq!((&json["attitude_median_deg"], &json["attitude_95_percent_deg"]), (&4.0.into(), &9.0.into()));
    let text = summary.to_string();
    assert!(text.contains("1.500 s: tilt above 90°"), "{text}");
    assert!(text.contains("sim-host fly bench --seed 18446744073716 --duration 0.05"), "{text}");
}

#[test]
fn no_run_starts_after_stop_is_set() {
    let campaign = Campaign::new(&scene(), 1_000);
    let stop = AtomicBool::new(false);
    let finished = AtomicU64::new(0);
    let runs = fly(&scene(), &campaign, 0..1_000, NonZeroUsize::new(2).unwrap(), &stop, &|| {
        if finished.fetch_add(1, Ordering::Relaxed) == 4 {
            stop.store(true, Ordering::Relaxed);
        }
    });
    assert!((5..=7).contains(&runs.len()), "{}", runs.len());
}
