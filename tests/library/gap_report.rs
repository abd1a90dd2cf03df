//! The page of a diagnosis: complete, self-contained, and equal to the stored snapshot.
//!
//! `INSTA_UPDATE=always cargo test --test library gap_report` accepts an intended change.

use retroflex::diagnosis::tip::{
    Diagnosis, EffectEntry, Gap, Location, ParamValue, QuantityShare, StageShare, UnknownEntry,
};
use retroflex::diagnosis::verdict::{Verdict, VerdictKind};
use retroflex::report::gap::charts::Trace;
use retroflex::report::gap::evidence::{Evidence, Spot};
use retroflex::report::gap::{page, words};

fn effect(name: &'static str, stage: &'static str, probability: f64, closed: f64) -> EffectEntry {
    EffectEntry {
        name,
        stage,
        probability,
        gap_before_deg: 3.0,
        gap_after_deg: 3.0 * (1.0 - closed),
        closed,
        closed_ci95: [closed - 0.05, closed + 0.03],
        params: vec![ParamValue {
            name: "latency",
            unit: "s",
            value: 0.0812,
            ci95: [0.078, 0.084],
            channel: 0,
        }],
    }
}

fn diagnosis(
    kind: VerdictKind,
    names: &[&'static str],
    equivalent: &[&[&'static str]],
) -> Diagnosis {
    Diagnosis {
        schema: 1,
        gap: Gap {
            as_configured_deg: 6.1,
            recalibrated_deg: 3.0,
            explained_deg: 0.4,
            noise_floor_deg: 0.15,
        },
        location: Location {
            stages: vec![
                StageShare {
                    name: "timing",
                    share: 0.9,
                },
                StageShare {
                    name: "bellows",
                    share: 0.1,
                },
            ],
            merged: vec![],
            regions: vec![],
            when: vec![],
            kinds: vec![QuantityShare {
                name: "gyroscope",
                rmse_deg: 4.0,
                explained_deg: 0.5,
            }],
        },
        effects: vec![
            effect("sensor_latency", "timing", 0.5, 0.9),
            effect("transport_delay", "timing", 0.48, 0.89),
            effect("creep", "bellows", 0.02, 0.1),
        ],
        verdict: Verdict {
            kind,
            names: names.to_vec(),
            probability: 0.9,
            equivalent: equivalent.iter().map(|g| g.to_vec()).collect(),
            conformal: vec![],
            doubt: 0.03,
        },
        unknown: UnknownEntry {
            probability: 0.03,
            rmse_deg: 0.37,
            goes_with: vec![],
        },
        logs: vec![],
        rivals: vec![],
    }
}

fn evidence() -> Evidence {
    let spot = |k: u32| {
        let t_s = f64::from(k) * 2.0;
        Spot {
            t_s,
            bend_deg: f64::from(k % 6) * 14.0,
            dir_deg: f64::from(k * 50 % 360),
            before_deg: 2.0 + f64::from(k % 3),
            after_deg: 0.4,
        }
    };
    let point = |k: u32| {
        let (t, x) = (f64::from(k) * 0.5, f64::from(k % 20));
        if k == 7 {
            [t, x, f64::NAN, f64::NAN]
        } else {
            [t, x, x + 3.0, x + 0.4]
        }
    };
    Evidence {
        spots: (0..30).map(spot).collect(),
        traces: vec![Trace {
            label: "gravity along sensor x".to_owned(),
            points: (0..120).map(point).collect(),
        }],
    }
}

/// What a page was made from.
fn made() -> [[String; 2]; 2] {
    [["small.csv", "20 s, hash 00"], ["seed", "1"]].map(|row| row.map(str::to_owned))
}

#[test]
fn the_page_equals_its_snapshot() {
    let d = diagnosis(
        VerdictKind::Effects,
        &["sensor_latency"],
        &[&["transport_delay", "sensor_latency"]],
    );
    insta::assert_snapshot!(page("small.csv", &d, &evidence(), &made()));
}

#[test]
fn the_page_is_complete_and_one_file_without_scripts() {
    let d = diagnosis(
        VerdictKind::Effects,
        &["sensor_latency"],
        &[&["transport_delay", "sensor_latency"]],
    );
    let html = page("a<b>.csv", &d, &evidence(), &made());
    for word in [
        "a&lt;b&gt;.csv",
        "transport delay",
        "gap excite",
        "Residual over time",
        "3.00°",
        "90 %",
        "Recalibrated model",
    ] {
        assert!(html.contains(word), "{word}");
    }
    for word in ["<script", "src=", "href=", "url(", "@import", "NaN", "inf"] {
        assert!(!html.contains(word), "{word}");
    }
    assert_eq!(html.matches("<svg").count(), html.matches("</svg>").count());
    assert_eq!(html.matches("<figure>").count(), 7);
    // a picture inside a picture is inverted with it, not once more
    assert!(html.contains(" figure > svg { filter: invert(1)"));
}

#[test]
fn every_verdict_is_put_in_words() {
    let cases = [
        (
            diagnosis(VerdictKind::None, &[], &[]),
            "nominal model suffices",
            "The model needs no addition",
        ),
        (
            diagnosis(VerdictKind::Effects, &["creep"], &[]),
            "Creep explains the gap",
            "gap check",
        ),
        (
            diagnosis(VerdictKind::Effects, &["creep", "sensor_latency"], &[]),
            "Creep and sensor latency together explain the gap",
            "gap check",
        ),
        (
            diagnosis(
                VerdictKind::Effects,
                &["sensor_latency"],
                &[&["transport_delay", "sensor_latency"]],
            ),
            "Either transport delay or sensor latency explains",
            "outside reference",
        ),
        (
            diagnosis(VerdictKind::Unknown, &[], &[]),
            "not in the catalogue",
            "gap excite",
        ),
        (
            diagnosis(VerdictKind::Unknown, &["creep"], &[]),
            "Creep explains a part",
            "gap excite",
        ),
    ];
    for (d, headline, next) in cases {
        assert!(
            words::headline(&d).contains(headline),
            "{}",
            words::headline(&d)
        );
        let all = words::next(&d).join(" ");
        assert!(all.contains(next), "{all}");
    }
}
