//! Slots that are torn, damaged, exchanged or not there, and what is believed of them.

use super::*;
use crate::control::tick::RestartState;
use crate::service::LearnedGains;

fn memory(n: i32) -> Memory {
    let restart = RestartState {
        steps: crate::primitives::units::Steps([n, -n, 7]),
        bend_rad: [0.1, 1.0 / 3.0],
        play_output_mm: [0.1, 0.2, 0.3],
        k_epsilon: [2.2; 3],
        k_lambda_mm: [0.9; 3],
        lag_s: 0.03,
        delay_s: 0.01,
        dynamics_uncertainty_s: 0.02,
        caution: Default::default(),
        laws: None,
        rest: None,
    };
    Memory {
        tip: "A".to_owned(),
        restart: Some(restart),
        ..Memory::default()
    }
}

#[test]
fn every_torn_write_fails_its_checksum() {
    let (old, new) = (
        compose(1, &memory(1)).unwrap(),
        compose(3, &memory(-9)).unwrap(),
    );
    for cut in 1..old.len().min(600) {
        let torn: Vec<u8> = new[..cut].iter().chain(&old[cut..]).copied().collect();
        match parse(&torn) {
            Err(_) => {}
            Ok(read) => assert!(torn == old || torn == new, "cut {cut}: {read:?}"),
        }
    }
}

/// Every number of a memory in turn, with a checksum that is right.
#[test]
fn a_number_that_no_machine_has_is_refused() {
    let mut whole = memory(1);
    whole.restart.as_mut().unwrap().rest = Some(crate::control::tick::RestartRest {
        acc_m_s2: [0.1, 0.2, 9.7],
        mag_ut: Some([20.0, 1.0, -40.0]),
        gyro_bias_rad_s: [0.01, 0.0, -0.01],
    });
    whole.accepted = Some(LearnedGains {
        k_epsilon: [2.2; 3],
        k_lambda_mm: [0.9; 3],
        lag_s: 0.1,
        delay_s: 0.02,
        tip: "A".to_owned(),
        unix_s: 1.7e9,
        source: "test".to_owned(),
    });
    whole.proposed = whole.accepted.clone();
    let good = serde_json::to_value(&whole).unwrap();
    let read = |body: &serde_json::Value| parse(seal(3, &body.to_string()).as_bytes());
    assert!(read(&good).unwrap().is_some());
    let (mut paths, mut open) = (Vec::new(), vec![String::new()]);
    while let Some(path) = open.pop() {
        match good.pointer(&path).unwrap() {
            serde_json::Value::Object(map) => {
                open.extend(map.keys().map(|key| format!("{path}/{key}")));
            }
            serde_json::Value::Array(all) => {
                open.extend((0..all.len()).map(|k| format!("{path}/{k}")));
            }
            serde_json::Value::Number(_) if !path.ends_with("unix_s") => paths.push(path),
            _ => (),
        }
    }
    assert!(paths.len() > 30, "{paths:?}");
    for path in paths {
        for value in [1e300, -1e300, 1e13, -1e13] {
            let mut bad = good.clone();
            *bad.pointer_mut(&path).unwrap() = value.into();
            assert!(read(&bad).is_err(), "{path} = {value}");
        }
    }
    let late = seal(u64::MAX, &good.to_string());
    assert!(parse(late.as_bytes()).is_err());
}

#[test]
fn a_state_that_is_not_finite_is_not_written() {
    let mut bad = memory(1);
    bad.restart.as_mut().unwrap().lag_s = f64::NAN;
    assert!(matches!(compose(1, &bad), Err(MemoryError::NotFinite)));
}

#[test]
fn open_returns_the_newest_write() {
    let folder = tempfile::tempdir().unwrap();
    for n in 1..6 {
        let (mut store, recall) = Store::open(folder.path()).unwrap();
        assert_eq!(
            recall.found,
            if n == 1 { Found::Absent } else { Found::Intact },
            "{:?}",
            recall.damaged
        );
        assert_eq!(recall.memory, (n > 1).then(|| memory(n - 1)));
        // the first write fills both slots
        assert_eq!(store.write(&memory(n)).unwrap(), n as u64 + 1);
    }
}

/// What the store says after `change` to a folder with five writes: state, newest memory, and the report.
fn after(change: impl Fn(&Path)) -> Recall {
    let folder = tempfile::tempdir().unwrap();
    let (mut store, _) = Store::open(folder.path()).unwrap();
    (1..5).for_each(|n| assert!(store.write(&memory(n)).is_ok()));
    drop(store);
    change(folder.path());
    Store::open(folder.path()).unwrap().1
}

#[test]
fn only_a_whole_pair_of_slots_is_intact() {
    let (a, b) = ("memory.a", "memory.b");
    assert_eq!(after(|_| ()).found, Found::Intact);
    assert_eq!(
        after(|f| [a, b]
            .iter()
            .for_each(|n| std::fs::remove_file(f.join(n)).unwrap()))
        .found,
        Found::Absent
    );
    for name in [a, b] {
        let write = |f: &Path, bytes: &[u8]| std::fs::write(f.join(name), bytes).unwrap();
        let old = |f: &Path| std::fs::read(f.join(name)).unwrap();
        type Change<'a> = (&'static str, &'a dyn Fn(&Path));
        let changes: [Change<'_>; 8] = [
            ("has 0 bytes", &|f| write(f, b"")),
            ("has 500 bytes", &|f| write(f, &old(f)[..500])),
            ("header", &|f| write(f, &[0; SIZE])),
            ("empty", &|f| write(f, &[b' '; SIZE])),
            ("belong together", &|f| {
                std::fs::remove_file(f.join(name)).unwrap()
            }),
            ("checksum", &|f| {
                write(f, &{
                    let mut t = old(f);
                    t[100] ^= 1;
                    t
                })
            }),
            ("belong together", &|f| {
                std::fs::copy(f.join(if name == a { b } else { a }), f.join(name)).unwrap();
            }),
            ("version 9", &|f| {
                write(f, &{
                    let mut t = b"retroflex-memory 9 1 1 00000000\nx".to_vec();
                    t.resize(SIZE, b' ');
                    t
                })
            }),
        ];
        for (part, change) in changes {
            let recall = after(change);
            assert_eq!(recall.found, Found::Damaged, "{name}: {part}");
            assert!(
                recall.damaged.iter().any(|d| d.contains(part)),
                "{name}: {part}: {:?}",
                recall.damaged
            );
        }
    }
    let swapped = after(|f| {
        std::fs::rename(f.join(a), f.join("x")).unwrap();
        std::fs::rename(f.join(b), f.join(a)).unwrap();
        std::fs::rename(f.join("x"), f.join(b)).unwrap();
    });
    assert_eq!(swapped.found, Found::Damaged);
}

#[test]
fn a_damaged_slot_is_renamed_and_the_next_write_fills_both() {
    let folder = tempfile::tempdir().unwrap();
    Store::open(folder.path())
        .unwrap()
        .0
        .write(&memory(1))
        .unwrap();
    std::fs::write(folder.path().join("memory.b"), [0; SIZE]).unwrap();
    let (mut store, recall) = Store::open(folder.path()).unwrap();
    assert!(recall.found == Found::Damaged && folder.path().join("memory.b.damaged-1").exists());
    store.write(&memory(2)).unwrap();
    drop(store);
    let (_store, recall) = Store::open(folder.path()).unwrap();
    assert_eq!(
        (recall.found, recall.memory),
        (Found::Intact, Some(memory(2)))
    );
}

/// Every file of the state in turn: a link, a pipe, a folder, a socket.
#[test]
fn only_regular_files_of_the_owner_are_opened_and_no_links() {
    use std::os::unix::net::UnixListener;
    let mode = |path: &Path| std::fs::metadata(path).unwrap().mode() & 0o777;
    for name in ["memory.a", "memory.b", "lock"] {
        for kind in ["link", "dangling", "pipe", "folder", "socket"] {
            let outer = tempfile::tempdir().unwrap();
            let folder = outer.path().join("state");
            Store::open(&folder).unwrap().0.write(&memory(1)).unwrap();
            assert_eq!(mode(&folder), 0o700);
            for name in ["memory.a", "memory.b", "lock"] {
                assert_eq!(mode(&folder.join(name)), 0o600, "{name}");
            }
            let (path, other) = (folder.join(name), outer.path().join("other"));
            std::fs::remove_file(&path).unwrap();
            let _listener = match kind {
                "socket" => Some(UnixListener::bind(&path).unwrap()),
                _ => None,
            };
            match kind {
                "link" => {
                    std::fs::write(&other, "mine").unwrap();
                    std::os::unix::fs::symlink(&other, &path).unwrap();
                }
                "dangling" => std::os::unix::fs::symlink(&other, &path).unwrap(),
                "folder" => std::fs::create_dir(&path).unwrap(),
                "pipe" => {
                    // a command would hold the locks of other tests until it runs
                    nix::unistd::mkfifo(&path, nix::sys::stat::Mode::S_IRUSR).unwrap();
                }
                _ => {}
            }
            // a slot is renamed as damaged, which the lock cannot be
            match Store::open(&folder) {
                Ok((mut store, recall)) => {
                    assert_eq!(recall.found, Found::Damaged, "{name} {kind}");
                    store.write(&memory(2)).unwrap();
                    assert_ne!(name, "lock");
                }
                Err(e) => assert_eq!(name, "lock", "{kind}: {e}"),
            }
            let there = std::fs::read_to_string(&other).unwrap_or_default();
            assert_eq!(
                there,
                if kind == "link" { "mine" } else { "" },
                "{name} {kind}"
            );
        }
    }
}

#[test]
fn a_folder_in_use_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (_one, _) = Store::open(folder.path()).unwrap();
    assert!(matches!(
        Store::open(folder.path()),
        Err(MemoryError::InUse { .. })
    ));
}

#[test]
fn only_an_intact_memory_is_believed() {
    let recall = |found, armed, lost| Recall {
        memory: Some(Memory {
            armed,
            lost,
            ..Memory::default()
        }),
        damaged: vec![],
        found,
        sequence: 1,
    };
    assert_eq!(
        Recall::default().belief(),
        Belief::Lost,
        "a machine without a memory"
    );
    assert_eq!(
        recall(Found::Intact, false, false).belief(),
        Belief::Certain
    );
    for bad in [
        recall(Found::Intact, true, false),
        recall(Found::Intact, false, true),
        recall(Found::Damaged, false, false),
    ] {
        assert_eq!(bad.belief(), Belief::Lost, "{bad:?}");
    }
}

/// Starts that end before their first write, in it, and between the two slots that it fills.
#[test]
fn a_first_start_that_ends_early_leaves_nothing_that_counts_as_damage() {
    let folder = tempfile::tempdir().unwrap();
    let open = || Store::open(folder.path()).unwrap();
    for _ in 0..3 {
        let (_store, recall) = open();
        assert_eq!(recall, Recall::default());
    }
    for cut in [0, 1, 700, SIZE - 1] {
        let part = compose(1, &memory(1)).unwrap()[..cut].to_vec();
        std::fs::write(folder.path().join("memory.a.part"), part).unwrap();
        let (_store, recall) = open();
        assert_eq!(recall, Recall::default(), "{cut}");
    }
    open().0.write_slot(&memory(1)).unwrap();
    let (mut store, recall) = open();
    assert_eq!((recall.found, recall.damaged), (Found::Absent, vec![]));
    store.write(&memory(2)).unwrap();
    drop(store);
    let recall = open().1;
    assert_eq!(
        (recall.found, recall.memory),
        (Found::Intact, Some(memory(2)))
    );
    assert!(!folder.path().join("memory.a.part").exists());
}

/// A start that fails after it has found damage does not make the next one forget it.
#[test]
fn damage_stays_until_the_next_write() {
    let folder = tempfile::tempdir().unwrap();
    Store::open(folder.path())
        .unwrap()
        .0
        .write(&memory(1))
        .unwrap();
    for name in SLOTS {
        std::fs::write(folder.path().join(name), [0; SIZE]).unwrap();
    }
    for _ in 0..3 {
        assert_eq!(Store::open(folder.path()).unwrap().1.found, Found::Damaged);
    }
}

/// Every bit of the text, and one of every byte after it.
#[test]
fn one_inverted_bit_anywhere_in_a_slot_is_noticed() {
    let whole = compose(7, &memory(1)).unwrap();
    let text = whole.trim_ascii_end().len();
    let bits = (0..text * 8).chain((text..SIZE).map(|byte| byte * 8 + byte % 8));
    for bit in bits {
        let mut slot = whole.clone();
        slot[bit / 8] ^= 1 << (bit % 8);
        assert!(parse(&slot).is_err(), "bit {} of byte {}", bit % 8, bit / 8);
    }
}
