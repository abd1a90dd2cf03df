//! The schemas of a flight log: those of Foxglove and of `retroflex.proto`, the same in every file, and every message fits them.
//!
//! `REFRESH=1 cargo test --test program schemas` compiles `src/service/flight/schemas.bin` anew.

use crate::common::flight::fly;
use crate::common::repo;
use foxglove::Encode;
use foxglove::messages::{FrameTransform, Log, SceneUpdate};
use prost_reflect::prost::Message as _;
use prost_reflect::prost_types::FileDescriptorSet;
use prost_reflect::{DescriptorPool, DynamicMessage};
use retroflex::cli::flight::read;
use retroflex::config::gains::Gains;
use retroflex::drill::bench::{Bench, bend};
use retroflex::motion::machine::Alarm;
use retroflex::service::flight::schema::{self, TOPICS};
use retroflex::supervisor::cycle::order::Order;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// The descriptors of all schemas: files of Foxglove as its SDK holds them, then ours.
fn compiled() -> Vec<u8> {
    let foxglove = [
        FrameTransform::get_schema(),
        SceneUpdate::get_schema(),
        Log::get_schema(),
    ];
    let mut compiler = protox::Compiler::new([repo("src/service/flight")]).unwrap();
    compiler.open_file("retroflex.proto").unwrap();
    let own = compiler.file_descriptor_set().encode_to_vec();
    let mut all = FileDescriptorSet::default();
    for bytes in foxglove
        .map(|schema| schema.unwrap().data.into_owned())
        .into_iter()
        .chain([own])
    {
        for file in FileDescriptorSet::decode(&*bytes).unwrap().file {
            if !all.file.iter().any(|known| known.name == file.name) {
                all.file.push(file);
            }
        }
    }
    all.encode_to_vec()
}

#[test]
fn the_schemas_are_those_of_their_sources() {
    let (path, now) = (repo("src/service/flight/schemas.bin"), compiled());
    if std::env::var_os("REFRESH").is_some() {
        std::fs::write(&path, &now).unwrap();
    }
    assert!(
        std::fs::read(&path).unwrap() == now,
        "if the schemas were meant to change: REFRESH=1 cargo test --test program schemas"
    );
    for (topic, name) in TOPICS {
        let pool = DescriptorPool::decode(&*schema::description(topic).unwrap()).unwrap();
        assert!(pool.get_message_by_name(name).is_some(), "{topic}");
        assert!(!schema::fields(topic).is_empty(), "{topic}");
    }
}

/// A flight in which everything that can be absent is once there and once not.
fn script(ms: u64, bench: &mut Bench) -> Option<Order> {
    match ms {
        4500 => bench.runner.machine.alarm = Some(Alarm::Pressure { kpa: 60.0 }),
        5000 => bench.runner.machine.clear_faults(),
        _ => {}
    }
    match ms {
        3000 => Some(Order::Arm),
        3100 => Some(bend(40.0, 70.0)),
        _ => None,
    }
}

/// Name, encoding and text of the schema of each topic of a file, and how many messages it has, all of which fit.
fn topics(path: &Path) -> BTreeMap<String, ([Vec<u8>; 3], usize)> {
    let mut all = BTreeMap::<String, ([Vec<u8>; 3], usize)>::new();
    let mut pools = BTreeMap::new();
    read(path, &mut |_, message| {
        let (topic, schema) = (
            &message.channel.topic,
            message.channel.schema.as_ref().unwrap(),
        );
        let texts = [
            schema.name.clone().into(),
            schema.encoding.clone().into(),
            schema.data.to_vec(),
        ];
        let (known, count) = all.entry(topic.clone()).or_insert((texts.clone(), 0));
        *count += 1;
        assert!(*known == texts, "{topic} has two schemas");
        assert_eq!(
            (&*schema.encoding, &*message.channel.message_encoding),
            ("protobuf", "protobuf")
        );
        let pool = pools
            .entry(topic.clone())
            .or_insert_with(|| DescriptorPool::decode(&*schema.data).unwrap());
        let descriptor = pool.get_message_by_name(&schema.name).unwrap();
        let value = DynamicMessage::decode(descriptor, &*message.data).unwrap();
        assert_eq!(value.unknown_fields().count(), 0, "{topic}");
        Ok(())
    })
    .unwrap();
    all
}

/// Flights with different machines and filters, and one that was replayed from a log of an older version.
#[test]
fn every_file_has_the_same_schemas_and_every_message_fits() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    fly(&file("a.mcap"), Gains::default(), 6.0, script);
    fly(&file("still.mcap"), Gains::default(), 2.0, |_, _| None);
    // of an older version, whose topics were JSON
    let old = "tests/replay/json/fault.mcap";
    for (args, recorded) in [
        (["replay", "--out", "again.mcap"], "tests/replay/fault.mcap"),
        (["log", "cut", "cut.mcap"], old),
    ] {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_retroflex"));
        command.args(&args[..2]).current_dir(folder.path());
        if args[0] == "log" {
            command.args(["--from", "1", "--out"]);
        }
        let done = command.arg(args[2]).arg(repo(recorded)).output().unwrap();
        assert!(
            done.status.success(),
            "{}",
            String::from_utf8_lossy(&done.stderr)
        );
    }
    let all = ["a.mcap", "still.mcap", "again.mcap", "cut.mcap"].map(|name| topics(&file(name)));
    for other in &all[1..] {
        for (topic, (schema, _)) in other {
            assert!(all[0][topic].0 == *schema, "{topic}");
        }
    }
    let named: BTreeSet<&str> = TOPICS.iter().map(|(topic, _)| *topic).collect();
    let flown: BTreeSet<&str> = all[0].keys().map(String::as_str).collect();
    assert_eq!(
        named.difference(&flown).copied().collect::<Vec<_>>(),
        ["/imu/base"]
    );
    assert!(all[0]["/imu"].1 > 500 && all[0]["/scene"].1 > 10 && all[0]["/log"].1 > 3);
    assert!(all[3]["/angles"].1 > 50);
}

/// What people are shown is what the loop decided: the fields of a message read back are those of the status.
#[test]
fn a_message_reads_back_as_it_was_written() {
    let angles = serde_json::json!({
        "target": null, "setpoint": {"bend_deg": 12.5, "dir_deg": -90.0}, "estimate": null, "sigma_deg": null,
        "belief": {"bend_deg": 0.0, "dir_deg": 0.25}, "belief_sigma_deg": 0.0, "residual_deg": 0.5, "length_mm": 20.0,
    });
    let message = schema::encode("/angles", angles.clone()).unwrap();
    assert_eq!(schema::decode("/angles", &message).unwrap(), angles);
    let gains = serde_json::json!({"k_epsilon": [1.5, null, 2.0]});
    let read = schema::decode("/gains", &schema::encode("/gains", gains).unwrap()).unwrap();
    assert_eq!(read["k_epsilon"], serde_json::json!([1.5, "NaN", 2.0]));
    assert!(schema::encode("/angles", serde_json::json!({"targets": 1})).is_err());
    assert!(schema::encode("/elsewhere", serde_json::json!({})).is_err());
}
