//! Reports of a diagnosis: the page, the picture of the ladder, the text. The diagnosis is made up by hand, so that
//! every number is known.

use base64::Engine as _;
use propwash::gap::compare::{
    Axes, ClosedLoop, Comparison, Horizon, LogComparison, OneStep, Segment, Series,
};
use propwash::gap::decide::rules::{Rule, Why};
use propwash::gap::report::{
    Against, Bin, LADDER_PNG_WIDTH, Overlay, Report, ResidualSeries, TEXT_COLUMNS, WorstSegment, ladder_png,
    text,
};
use propwash::gap::track::Noise;
use propwash::gap::verdict::{
    Advice, Calibration, Diagnosis, Finding, FreeTerm, HeldOut, HorizonError, Lack, Limit, LogSummary,
    LookAlike, OfOneLog, Opinion, ParameterFit, Remainder, Rung, Said,
};
use propwash::gap::{Cause, Response};
use propwash::physics::effects::Area;
use std::path::PathBuf;

fn fit(name: &str, unit: &str, filed: f64, value: f64, sigma: f64) -> ParameterFit {
    ParameterFit { name: name.into(), unit: unit.into(), filed, value, sigma }
}

fn log(name: &str, held_out: bool) -> LogSummary {
    LogSummary {
        name: name.into(),
        sha256: "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08".into(),
        duration_s: if held_out { 31.7 } else { 52.4 },
        drive: "rotor speeds".into(),
        noise: Noise {
            position_m: if held_out { 0.00047 } else { 0.00031 },
            attitude_rad: 0.0034,
            gyro_rad_s: 0.0117,
            accel_m_s2: f64::NAN,
            rotor_rad_s: None,
            thrust_n: None,
            stated: [false; 4],
        },
        held_out,
    }
}

fn errors(scale: f64) -> Vec<HorizonError> {
    [0.1, 0.2, 0.5, 1.0]
        .iter()
        .map(|h: &f64| HorizonError {
            horizon_s: *h,
            position_m: 0.0004 + 0.0671 * scale * h.powf(2.0),
            velocity_m_s: 0.0021 + 0.153 * scale * h,
            attitude_rad: 0.0029 + 0.087 * scale * h.powf(1.5),
            rate_rad_s: 0.0119 + 0.43 * scale * h,
            n: (50.0 / h) as usize,
        })
        .collect()
}

/// What is missing at the instants of a flight.
fn lack(scale: f64) -> Lack {
    Lack {
        force_n: 0.0395 * scale,
        force_times_noise: 8.73 * scale,
        torque_n_m: Some(3.3e-4 * scale),
        torque_times_noise: Some(5.1 * scale),
        n: 400,
    }
}

fn rung(label: &str, training: f64, held_out: f64) -> Rung {
    Rung {
        label: label.into(),
        training: errors(training),
        held_out: errors(held_out),
        training_lack: Some(lack(training)),
        held_out_lack: Some(lack(held_out)),
    }
}

fn opinion(said: Said, text: &str) -> Opinion {
    Opinion { said, gain: None, gain_sigma: None, text: text.into() }
}

/// A parameter within tolerance whose estimate does not help on unseen flight.
fn calibration(id: &str, kind: &str, area: Area, parameter: ParameterFit) -> Calibration {
    Calibration {
        id: id.into(),
        kind: kind.into(),
        area,
        parameter,
        set: vec![],
        tolerance: 0.0,
        helps: false,
        partner: false,
    }
}

fn motor_lag() -> Calibration {
    let fitted = fit("time_constant_s", "s", 0.0721, 0.0748, 0.00058);
    calibration("motor_lag", "motor_lag", Area::Drive, fitted)
}

/// A certain effect, checked on unseen flight.
fn rotor_drag() -> Finding {
    Finding {
        id: "rotor_drag".into(),
        kind: "rotor_drag".into(),
        title: "drag that grows with speed and rotor speed".into(),
        area: Area::Airframe,
        parameters: vec![
            fit("drag_n_s2_per_rad_m.0", "N·s²/(rad·m)", 0.0, 9.174e-7, 1.13e-8),
            fit("drag_n_s2_per_rad_m.1", "N·s²/(rad·m)", 0.0, 8.836e-7, 1.31e-8),
        ],
        set: vec![],
        evidence_nats: 913.0,
        removed_share: 0.874,
        certain: true,
        second: opinion(Said::Agrees, "agrees: explains 90 % of the force that is left on other flight"),
        look_alikes: vec![],
        stands_for: vec![],
        held_out: Some(HeldOut {
            channel: "force across the rotors".into(),
            unit: "N".into(),
            without: 0.0395,
            with: 0.00447,
            times_noise: Some([8.73, 1.21]),
            roll_outs: 0.183,
            written: true,
            doubt: None,
            little: false,
        }),
        each_log: false,
    }
}

/// An uncertain one, with a look-alike.
fn weak_rotor() -> Finding {
    Finding {
        id: "weak_rotor.2".into(),
        kind: "weak_rotor".into(),
        title: "rotor 2 gives less thrust than the others".into(),
        area: Area::Drive,
        parameters: vec![fit("factor.1", "1", 1.0, 0.9243, 0.00382)],
        set: vec![],
        evidence_nats: 41.6,
        removed_share: 0.0631,
        certain: false,
        second: opinion(Said::Silent, "could not see an effect of this size"),
        look_alikes: vec![LookAlike {
            ids: vec!["com_offset.y".into(), "torque_scale".into()],
            title: "centre of mass to the side, with another torque constant".into(),
            worse_by_nats: 2.7,
            manoeuvre: "climb and sink hard, so that the collective thrust changes by half".into(),
        }],
        stands_for: vec!["weak_rotor.1".into()],
        held_out: None,
        each_log: false,
    }
}

/// What the two effects leave unexplained.
fn remainder() -> Remainder {
    Remainder {
        force_m_s2: 0.0926,
        torque_rad_s2: 1.83,
        force_before_m_s2: 0.557,
        force_agreed_m_s2: None,
        torque_agreed_rad_s2: None,
        torque_before_rad_s2: 6.38,
        faint: false,
        unexplained: true,
        terms: vec![
            FreeTerm {
                on: "torque about body z".into(),
                variable: "v_x |v|".into(),
                coefficient: 0.3462,
                sigma: 0.0417,
                explained_share: 0.2213,
            },
            FreeTerm {
                on: "force along body x".into(),
                variable: "sin(2 roll) · thrust".into(),
                coefficient: -1.94e-5,
                sigma: 0.28e-5,
                explained_share: 0.0814,
            },
        ],
        text: "A yawing moment that grows with forward speed is not in the list of effects.".into(),
    }
}

/// What single effects would explain, nats.
fn singles() -> Vec<(String, f64)> {
    [
        ("rotor_drag", 871.0),
        ("linear_drag", 842.0),
        ("quadratic_drag", 611.0),
        ("inflow", 187.0),
        ("blade_flapping", 93.4),
        ("weak_rotor.2", 38.9),
        ("com_offset.y", 36.3),
        ("translational_lift", 12.1),
        ("gyro_bias", 1.24),
        ("payload", -2.31),
        ("thrust_scale", -2.62),
        ("constant_wind", -3.17),
        ("battery_sag", -3.58),
        ("world_tilt", -4.03),
    ]
    .map(|(id, nats)| (id.to_string(), nats))
    .to_vec()
}

/// Two effects, one of them uncertain, and something left.
fn sample() -> Diagnosis {
    Diagnosis {
        vehicle: "crazyflie_2_1".into(),
        vehicle_sha256: "2c26b46b68ffc68ff99b453c1d30413413422d706483bfa0f98a5e886266e7ae".into(),
        dynamics: "first_principles".into(),
        logs: vec![log("chirps_and_steps.csv", false), log("figure_eight.csv", true)],
        verdict: "missing: rotor_drag; weak_rotor.2 (or com_offset.y + torque_scale)".into(),
        headline: "missing: rotor_drag; weak_rotor.2 (or com_offset.y + torque_scale)".into(),
        findings: vec![rotor_drag(), weak_rotor()],
        calibration: vec![motor_lag()],
        adjusted: vec![
            motor_lag(),
            calibration(
                "inertia.x",
                "wrong_inertia",
                Area::Mass,
                fit("inertia_kg_m2.0", "kg·m²", 1.657e-5, 1.663e-5, 2.2e-7),
            ),
            calibration(
                "wrong_mass",
                "wrong_mass",
                Area::Mass,
                fit("mass_kg", "kg", 0.0318, 0.03187, 0.00009),
            ),
        ],
        remainder: remainder(),
        ladder: vec![
            rung("as filed", 1.0, 1.13),
            rung("+ rotor_drag", 0.143, 0.168),
            rung("+ weak_rotor.2", 0.0193, 0.0271),
        ],
        advice: [
            "climb and sink hard: it tells weak_rotor.2 from com_offset.y + torque_scale",
            "fly 20 s of yaw steps at 3 m/s: it shows what turns the vehicle at speed",
        ]
        .map(|text| Advice { text: text.into(), manoeuvres: Vec::new() })
        .into(),
        not_tried: vec![("ceiling_effect".into(), "the logs name no ceiling".into())],
        singles: singles(),
        second: vec![],
        dispersion: 1.37,
        limits: vec![Limit {
            id: "ground_effect".into(),
            parameter: "strength".into(),
            unit: "1".into(),
            size: None,
            share: None,
            visible: false,
        }],
        formulas: Vec::new(),
        network: None,
        why: vec![
            Why {
                id: "rotor_drag".into(),
                rule: Rule::TwoEstimators,
                text: "certain: the regression agrees".into(),
            },
            Why {
                id: "gyro_bias".into(),
                rule: Rule::LittleGain,
                text: "left out: takes 3 % of the error".into(),
            },
        ],
        moments: Vec::new(),
        sections: Vec::new(),
        per_log: vec![OfOneLog {
            log: "chirps_and_steps.csv".into(),
            id: "clock_offset.gyro".into(),
            name: "gyro_s".into(),
            unit: "s".into(),
            value: -3.14e-3,
            shared: 0.73e-3,
            sigma: 0.21e-3,
        }],
        warnings: vec!["chirps_and_steps.csv: the gyroscope lags the poses by 8.2 ms; shifted".into()],
    }
}

/// Nothing is missing, and nothing else is to be said.
fn nothing_missing() -> Diagnosis {
    let mut d = sample();
    d.verdict = "nothing is missing".into();
    d.headline = d.verdict.clone();
    d.findings.clear();
    d.calibration.clear();
    d.adjusted.clear();
    d.ladder.truncate(1);
    d.advice.clear();
    d.not_tried.clear();
    d.singles.clear();
    d.warnings.clear();
    d.per_log.clear();
    d.why.clear();
    d.remainder.terms.clear();
    d.remainder.unexplained = false;
    d.remainder.text.clear();
    d
}

/// A number in −1…1 that looks random.
fn noise(k: usize) -> f64 {
    let mut x = (k as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 0xD1B5_4A32_D192_ED03;
    x ^= x >> 31;
    x = x.wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x ^= x >> 29;
    (x >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// A page with series of every sort.
fn full() -> Report {
    let t: Vec<f64> = (0..5200).map(|k| k as f64 * 0.01).collect();
    let speed = |t: f64| 2.5 * (0.4 * t).sin() + 0.8 * (1.3 * t).sin();
    let series =
        |f: &dyn Fn(usize, f64) -> f64| t.iter().enumerate().map(|(k, t)| f(k, *t)).collect::<Vec<f64>>();
    let overlay = |channel: &str, unit: &str, size: f64| {
        let restarted = |drift: f64| {
            series(&|k, t| {
                let since = (k % 100) as f64 * 0.01;
                if k % 100 == 99 { f64::NAN } else { size * (speed(t) + drift * since * since * speed(t)) }
            })
        };
        Overlay {
            log: "figure_eight.csv".into(),
            channel: channel.into(),
            unit: unit.into(),
            t_s: t.clone(),
            measured: series(&|k, t| size * (speed(t) + 0.01 * noise(k))),
            as_filed: restarted(0.45),
            with_effects: restarted(0.02),
        }
    };
    let residual = |name: &str, unit: &str, size: f64| ResidualSeries {
        log: "figure_eight.csv".into(),
        name: name.into(),
        unit: unit.into(),
        t_s: t.clone(),
        before: series(&|k, t| size * (-0.3 * speed(t) + 0.12 * noise(k))),
        after: series(&|k, t| size * (0.01 * speed(t) + 0.12 * noise(k + 9999))),
        sigma: Some(size * 0.07),
        worst: [(3.1, 5.2, "3.2 m/s, pitched 12°"), (18.4, 20.9, "3.0 m/s"), (34.2, 36.0, "turning fast")]
            .map(|(from_s, to_s, what)| WorstSegment {
                from_s,
                to_s,
                rms_before: size * 0.91,
                rms_after: Some(size * 0.072),
                what: what.into(),
            })
            .to_vec(),
    };
    let against = |residual: &str, unit: &str, cause: &str, cause_unit: &str, slope: f64| {
        let bins = |slope: f64, salt: usize| {
            (0..12)
                .map(|k| {
                    let cause = -3.0 + 0.5 * k as f64;
                    let sigma = 0.004 + 0.002 * cause.abs();
                    Bin { cause, mean: slope * cause + sigma * noise(k + salt), sigma, n: 400 }
                })
                .collect::<Vec<_>>()
        };
        Against {
            residual: residual.into(),
            unit: unit.into(),
            cause: cause.into(),
            cause_unit: cause_unit.into(),
            before: bins(slope, 0),
            after: bins(0.0, 77),
        }
    };
    Report {
        overlays: vec![
            overlay("position x", "m", 0.8),
            overlay("position z", "m", 0.3),
            overlay("pitch", "rad", 0.06),
            overlay("velocity x", "m/s", 1.0),
        ],
        residuals: vec![
            residual("force along body x", "N", 0.031),
            residual("torque about body z", "N·m", 2e-5),
        ],
        causes: vec![
            against("force along body x", "N", "forward speed", "m/s", -0.011),
            against("force along body y", "N", "sideways speed", "m/s", -0.0102),
            against("torque about body z", "N·m", "forward speed", "m/s", 2e-4),
        ],
        warnings: vec!["figure_eight.csv: 14 frames were dropped between 12.1 and 12.2 s".into()],
        ..Report::of(sample())
    }
}

/// Folder for output that a person can look at, when `PROPWASH_REPORT_OUT` names one.
fn keep(name: &str, bytes: &[u8]) {
    if let Some(folder) = std::env::var_os("PROPWASH_REPORT_OUT") {
        std::fs::write(PathBuf::from(folder).join(name), bytes)
            .expect("the folder for reports can be written");
    }
}

/// The page without the contents of its scripts and its style, and the contents apart.
fn take_apart(page: &str) -> (String, Vec<String>) {
    let (mut markup, mut inside, mut rest) = (String::new(), Vec::new(), page);
    loop {
        let starts = ["<script", "<style"].map(|tag| rest.find(tag).map(|at| (at, tag)));
        let Some((at, tag)) = starts.into_iter().flatten().min() else { break };
        let open = at + rest[at..].find('>').expect("a tag ends") + 1;
        let close = format!("</{}>", &tag[1..]);
        let end = open + rest[open..].find(&close).expect("an element ends");
        markup.push_str(&rest[..open]);
        inside.push(rest[open..end].to_string());
        rest = &rest[end..];
        markup.push_str(&close);
        rest = &rest[close.len()..];
    }
    markup.push_str(rest);
    (markup, inside)
}

/// The numbers of an array of a page's data.
fn held(array: &serde_json::Value) -> Vec<f64> {
    let text = array["base64"].as_str().expect("an array is base64");
    let bytes = base64::prelude::BASE64_STANDARD.decode(text).expect("base64");
    let number = |name: &str| array[name].as_f64().expect("a number");
    match array["of"].as_str() {
        Some("f32") => {
            bytes.chunks(4).map(|b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]))).collect()
        }
        Some("i16") => bytes
            .chunks(2)
            .map(|b| i16::from_le_bytes([b[0], b[1]]))
            .map(|n| if n == i16::MIN { f64::NAN } else { number("offset") + number("scale") * f64::from(n) })
            .collect(),
        other => panic!("{other:?} is no kind of number of a report"),
    }
}

/// Checks that every element that is opened is closed, in order.
fn assert_well_formed(markup: &str) {
    const EMPTY: [&str; 5] = ["meta", "link", "line", "circle", "br"];
    let mut open: Vec<String> = Vec::new();
    let mut rest = markup;
    while let Some(at) = rest.find('<') {
        let end = at + rest[at..].find('>').expect("a tag ends");
        let tag = &rest[at + 1..end];
        rest = &rest[end + 1..];
        if tag.starts_with('!') {
            continue;
        }
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop().as_deref(), Some(name), "closed before: {}", &rest[..rest.len().min(80)]);
            continue;
        }
        let name: String = tag.chars().take_while(|c| c.is_alphanumeric()).collect();
        assert_eq!(tag.matches('"').count() % 2, 0, "{tag}");
        if !EMPTY.contains(&name.as_str()) {
            open.push(name);
        }
    }
    assert_eq!(open, Vec::<String>::new());
}

fn assert_needs_no_network(markup: &str) {
    // The one link is an empty icon in the page itself: without it, browsers ask for one.
    let markup = &markup.replace("<link rel=\"icon\" href=\"data:,\">", "");
    for attribute in ["src=", "href=\"http", "href=\"//", "url(", "@import", "<link", "<iframe", "<base"] {
        assert!(!markup.contains(attribute), "{attribute} in the page");
    }
    assert!(markup.contains("default-src 'none'"), "the page forbids the browser to load anything");
}

#[test]
fn the_page_holds_every_effect_and_needs_no_network() {
    let report = full();
    let page = report.html();
    keep("full.html", page.as_bytes());
    let (markup, inside) = take_apart(&page);
    assert_well_formed(&markup);
    assert_needs_no_network(&markup);
    // The style is the only one of these that a browser reads as more than script.
    assert_needs_no_network(&format!("{} default-src 'none'", inside[0]));
    let d = report.diagnosis.as_ref().expect("the report has a diagnosis");
    assert!(markup.contains("What could hide in these logs") && markup.contains(">never<"));
    for f in &d.findings {
        assert!(markup.contains(&format!("<code>{}</code>", f.id)), "{}", f.id);
    }
    for (id, _) in
        d.singles.iter().chain(d.not_tried.iter().map(|(id, _)| (id.clone(), 0.0)).collect::<Vec<_>>().iter())
    {
        assert!(markup.contains(&format!("<code>{id}</code>")), "{id}");
    }
    for c in &d.adjusted {
        assert!(markup.contains(&c.id) && markup.contains(&c.parameter.name), "{}", c.id);
    }
    for words in [
        "com_offset.y + torque_scale",
        "39.5 → 4.47 mN",
        "8.7 → 1.2",
        "force that the model lacks",
        "fits worse by 2.7",
        "(9.17 ± 0.22)×10⁻⁷ N·s²/(rad·m)",
        "74.8 ± 1.1 ms",
        "0.9243 ± 0.0075",
        "climb and sink hard",
        "14 frames were dropped",
        "the gyroscope lags the poses",
        "In what the logs differ",
        "certain: the regression agrees",
        "little gain",
        "−3.87 ± 0.41 ms",
        "v_x |v|",
    ] {
        assert!(markup.contains(words), "{words}");
    }
    // Every link in the page leads somewhere, and every chart has its place.
    for part in markup.split("href=\"#").skip(1) {
        let id = part.split('"').next().expect("an attribute ends");
        assert!(markup.contains(&format!("id=\"{id}\"")), "{id}");
    }
    let charts: serde_json::Value = serde_json::from_str(&inside[2]).expect("the charts are JSON");
    let charts = charts.as_array().expect("a list of charts");
    assert_eq!(charts.len(), 4 + 2 + 3, "the ladder is drawn without the library");
    for chart in charts {
        let id = chart["id"].as_str().expect("a chart has an id");
        assert_eq!(markup.matches(&format!("id=\"{id}\"")).count(), 1, "{id}");
        assert!(!chart["traces"].as_array().expect("traces").is_empty(), "{id}");
    }
    let data: serde_json::Value = serde_json::from_str(&inside[1]).expect("the diagnosis is JSON");
    assert_eq!(data["findings"][1]["look_alikes"][0]["worse_by_nats"], 2.7);
}

#[test]
fn names_from_logs_cannot_break_the_page() {
    let evil = "</script><script>alert(1)</script><img src=x onerror='alert(2)'>\"&";
    let mut report = full();
    report.title = evil.into();
    report.warnings.push(evil.into());
    report.overlays[0].channel = evil.into();
    report.overlays[0].log = evil.into();
    report.residuals[0].worst[0].what = evil.into();
    report.causes[0].cause = evil.into();
    let d = report.diagnosis.as_mut().expect("the report has a diagnosis");
    d.headline = evil.into();
    d.vehicle = evil.into();
    d.findings[0].id = evil.into();
    d.findings[0].parameters[0].name = evil.into();
    d.findings[1].look_alikes[0].ids[0] = evil.into();
    d.ladder[1].label = evil.into();
    d.logs[0].name = evil.into();
    d.singles[0].0 = evil.into();
    d.remainder.terms[0].variable = evil.into();
    let (markup, inside) = take_apart(&report.html());
    assert_well_formed(&markup);
    assert!(!markup.contains("<img"), "a name became an element");
    assert_eq!(inside.len(), 6, "style, two of data, plots, what pages share, script");
    let charts: serde_json::Value = serde_json::from_str(&inside[2]).expect("the charts are JSON");
    assert!(charts.as_array().is_some_and(|c| !c.is_empty()));
    assert!(ladder_png(report.diagnosis.as_ref().expect("a diagnosis")).is_ok());
}

#[test]
fn a_page_where_nothing_is_missing_says_so() {
    let d = nothing_missing();
    let page = Report::of(d.clone()).html();
    keep("nothing.html", page.as_bytes());
    let (markup, _) = take_apart(&page);
    assert_well_formed(&markup);
    assert!(markup.contains("Nothing is missing."));
    for section in ["id=\"missing\"", "id=\"alike\"", "id=\"parameters\"", "id=\"next\"", "id=\"overlays\""] {
        assert!(!markup.contains(section), "{section} is empty and left out");
    }
    let words = text(&d);
    assert!(words.starts_with("crazyflie_2_1: nothing is missing\n"), "{words}");
    let empty = Report { title: "nothing at all".into(), ..Report::default() }.html();
    let (markup, inside) = take_apart(&empty);
    assert_well_formed(&markup);
    assert_eq!(inside[1], "null");
    assert!(markup.contains("holds no comparison and no diagnosis"));
    assert!(empty.len() < 60_000, "a page without charts carries no library");
}

#[test]
fn the_picture_of_the_ladder_has_its_size_and_its_lines() {
    let decoded = |d: &Diagnosis| {
        let bytes = ladder_png(d).expect("the picture can be drawn");
        let image = image::load_from_memory(&bytes).expect("a whole PNG");
        assert_eq!(image.width(), LADDER_PNG_WIDTH);
        assert!(image.height() > 62 * d.ladder.len() as u32, "a row for every rung");
        assert_eq!(image.color(), image::ColorType::Rgb8);
        image.into_rgb8().into_raw()
    };
    let count = |pixels: &[u8], rgb: [u8; 3]| pixels.chunks_exact(3).filter(|p| *p == rgb).count();
    keep("ladder.png", &ladder_png(&sample()).expect("the picture can be drawn"));
    let pixels = decoded(&sample());
    // Four measures: as filed a bar of full width, then shares of it (16.8 and 2.7 % of 1.13, and what noise adds).
    let [filed, found] = [[213, 94, 0], [0, 114, 178]].map(|ink| count(&pixels, ink));
    assert!(filed > 8000, "{filed}");
    assert!((0.1..0.5).contains(&(found as f64 / filed as f64)), "{found} of {filed}");
    let mut d = sample();
    d.ladder.clear();
    assert_eq!(count(&decoded(&d), [0, 114, 178]), 0);
    // Errors that are no numbers are left out.
    let mut d = sample();
    for rung in &mut d.ladder {
        for e in rung.training.iter_mut().chain(&mut rung.held_out) {
            (e.position_m, e.velocity_m_s, e.attitude_rad) = (0.0, f64::NAN, f64::INFINITY);
        }
    }
    assert!(count(&decoded(&d), [0, 114, 178]) > 500, "force and torque are left");
    let mut d = sample();
    for k in 0..12 {
        d.ladder.push(Rung {
            held_out: vec![],
            held_out_lack: None,
            ..rung(&format!("+ an_effect_of_a_very_long_name_that_goes_on_and_on.{k}"), 0.01, 0.01)
        });
    }
    keep("ladder_long.png", &ladder_png(&d).expect("the picture can be drawn"));
    decoded(&d);
}

/// The text on one line: where it breaks depends on the words before.
fn unwrapped(text: &str) -> String {
    text.split([' ', '\n']).filter(|word| !word.is_empty()).collect::<Vec<_>>().join(" ")
}

#[test]
fn the_text_has_every_number_once() {
    let words = text(&sample());
    keep("diagnosis.txt", words.as_bytes());
    println!("{words}");
    for number in [
        "(9.17 ± 0.22)×10⁻⁷ N·s²/(rad·m)",
        "(8.84 ± 0.26)×10⁻⁷ N·s²/(rad·m)",
        "0.9243 ± 0.0075",
        "74.8 ± 1.1 ms",
        "filed 72.10 ms",
        "87 %",
        "6.3 %",
        "913 nats",
        "41.6 nats",
        "2.7 nats",
        "0.346 ± 0.082",
        "22 %",
        "(−1.94 ± 0.55)×10⁻⁵",
        "8.1 %",
        "557 mm/s²",
        "92.6 mm/s²",
        "6.38 rad/s²",
        "1.83 rad/s²",
        "871",
        "52.4 s",
        "31.7 s",
        "310 µm",
        "470 µm",
        "1.37 times",
        "8.2 ms",
        "−3.87 ± 0.41 ms",
        "730 µs",
    ] {
        assert_eq!(words.matches(number).count(), 1, "{number} in\n{words}");
    }
    let sentence = "force across the rotors 39.5 → 4.47 mN, 8.7 → 1.2 times noise";
    assert!(unwrapped(&words).contains(sentence), "{words}");
    // The ladder: unseen flight at 1 s as filed is 0.0004 + 0.0671 · 1.13 m.
    assert!(words.contains("76.2 (67.5)"), "{words}");
    for (k, line) in words.lines().enumerate() {
        assert!(line.chars().count() <= TEXT_COLUMNS, "line {k} has {}: {line}", line.chars().count());
        assert_eq!(line.trim_end(), line, "line {k}");
    }
}

fn axes(size: f64) -> Axes {
    Axes {
        rms: [size, 0.7 * size, 0.3 * size],
        mean: [0.1 * size, -0.05 * size, 0.02 * size],
        sigma: [0.07 * size; 3],
        in_sigmas: [13.7, 9.31, 4.12],
        explained: [Some(0.118), Some(0.42), None],
    }
}

/// Residuals of single steps over 30 s; `share` of them is left.
fn one_step(share: f64) -> OneStep {
    let t: Vec<f64> = (0..600).map(|k| 0.05 * f64::from(k)).collect();
    let force = |t: f64| [0.02 * share * (0.4 * t).sin(), 0.01 * share * (0.7 * t).cos(), 0.004 * share];
    OneStep {
        n: 6000,
        force_from: "poses",
        torque_from: "gyroscope",
        certainty: "forces come from smoothed poses: above 8 Hz nothing is seen".into(),
        force: axes(0.017 * share),
        torque: Some(axes(3.1e-5 * share)),
        series: Series {
            t_s: t.clone(),
            force_body_n: t.iter().map(|t| force(*t)).collect(),
            force_world_n: t.iter().map(|t| force(*t)).collect(),
            force_sigma_n: [0.0012; 3],
            torque_n_m: t.iter().map(|t| (*t > 1.0).then(|| force(*t).map(|f| 1e-3 * f))).collect(),
            torque_sigma_n_m: [2e-6; 3],
        },
    }
}

/// Residuals that fall with forward velocity.
fn forward_velocity(share: f64) -> Cause {
    let values: Vec<f64> = (0..10).map(|k| -2.5 + 0.5 * f64::from(k)).collect();
    let mean = |v: f64| -0.008 * share * v;
    let response = |name: &str, title: &str, portion: f64| Response {
        name: name.into(),
        title: title.into(),
        unit: "N".into(),
        means: values.iter().map(|v| mean(*v)).collect(),
        standard_errors: vec![0.0009; values.len()],
        share: portion,
        significance: 60.0 * portion,
        correlation: -0.9,
        slope: -0.008 * share,
        slope_sigma: 0.0003,
    };
    Cause {
        name: "velocity_forward".into(),
        title: "forward velocity".into(),
        unit: "m/s".into(),
        edges: (0..11).map(|k| -2.75 + 0.5 * f64::from(k)).collect(),
        values: values.clone(),
        counts: vec![12; values.len()],
        responses: vec![
            response("force_body_x", "force along body x", 0.81),
            response("force_body_z", "force along body z", 0.01),
        ],
    }
}

/// A model against one flight; `share` of the residual is left.
fn comparison(share: f64) -> Comparison {
    Comparison {
        vehicle: "crazyflie_2_1".into(),
        vehicle_sha256: "2c26b46b".into(),
        logs: vec![LogComparison {
            log: log("figure_eight.csv", false),
            warnings: vec!["two rows without a time were left out".into()],
            one_step: one_step(share),
            horizons: errors(share)
                .iter()
                .map(|e| Horizon {
                    error: e.clone(),
                    expected: errors(0.0)[0].clone(),
                    times_expected: [Some(17.3), Some(8.8), Some(3.4), None],
                    times_sample_noise: [Some(31.0), None, Some(4.0), None],
                })
                .collect(),
            closed_loop: Some(ClosedLoop {
                duration_s: 29.3,
                position_m: 0.213 * share,
                velocity_m_s: 0.31,
                tracking_measured_m: 0.151,
                tracking_model_m: 0.0934,
                notes: vec!["gains as in the vehicle file".into()],
            }),
            closed_loop_missing: None,
            worst: vec![Segment {
                from_s: 3.0,
                to_s: 4.0,
                force_rms_n: 0.0193,
                torque_rms_n_m: Some(2e-5),
                in_sigmas: 16.1,
                context: vec![],
                text: "fast: 2.9 m/s".into(),
            }],
            causes: vec![forward_velocity(share)],
            findings: vec!["force along body x falls with forward velocity".into()],
            other_rotors: None,
            worst_times_noise: 17.3,
            agrees: false,
            verdict: "the model departs from the flight".into(),
        }],
        pooled: None,
        threshold: 2.0,
        agrees: false,
        within_tolerance: None,
        verdict: "the model departs from the flight: 17.3 times what noise makes".into(),
    }
}

#[test]
fn a_comparison_makes_a_page_with_and_without_what_was_found() {
    let mut report = Report::of_comparison(comparison(1.0));
    for after in [None, Some(comparison(0.04))] {
        let added = after.is_some();
        report.comparison_after = after;
        let page = report.html();
        keep(if added { "compared_after.html" } else { "compared.html" }, page.as_bytes());
        let (markup, inside) = take_apart(&page);
        assert_well_formed(&markup);
        assert_needs_no_network(&markup);
        assert!(markup.contains("The model departs from the flight: 17.3 times what noise makes."));
        for words in [
            "213 mm",
            "29.3 s",
            "smoothed poses",
            "two rows without a time",
            "fast: 2.9 m/s",
            "as in the vehicle file",
        ] {
            assert!(markup.contains(words), "{words}");
        }
        assert!(
            markup.contains(">your model<")
                && !markup.contains("as filed")
                && !markup.contains("with what was found")
        );
        // Position as filed after 1 s: 0.0004 + 0.0671 m; with what was found 0.0004 + 0.04 · 0.0671 m.
        assert!(markup.contains("67.5 mm (17 ×)"));
        assert_eq!(markup.contains("→ 3.08 mm"), added);
        let charts: serde_json::Value = serde_json::from_str(&inside[2]).expect("the charts are JSON");
        let charts = charts.as_array().expect("a list of charts");
        assert_eq!(charts.len(), 6 + 1, "force and torque on three axes; the one cause that tells something");
        for chart in charts {
            assert_eq!(chart["traces"].as_array().map(Vec::len), Some(if added { 2 } else { 1 }));
        }
        assert_eq!(charts[0]["y_title"], "mN");
        assert!(held(&charts[1]["traces"][0]["y"])[3].is_nan(), "no torque is known at first");
        let bins = &charts[6]["traces"];
        assert_eq!(held(&bins[0]["x"])[0], -2.5);
        assert!((held(&bins[0]["y"])[0] - 20.0).abs() < 1e-5, "{bins}");
        assert!((bins[0]["bars"][0].as_f64().expect("a bar") - 1.96 * 0.9).abs() < 1e-3);
    }
    // The stretch of 3 to 4 s with what was found: 4 % of the residual is left.
    let (markup, _) = take_apart(&report.html());
    let exact =
        |t: f64| (0.0008 * (0.4 * t).sin()).powi(2) + (0.0004 * (0.7 * t).cos()).powi(2) + 0.00016f64.powi(2);
    let times: Vec<f64> = (60..=80).map(|k| 0.05 * f64::from(k)).collect();
    let rms = (times.iter().map(|t| exact(*t)).sum::<f64>() / times.len() as f64).sqrt();
    assert!(markup.contains(&format!("{:.0} µN", 1e6 * rms)), "{} µN", 1e6 * rms);
}

#[test]
fn channels_that_the_drive_feeds_in_are_left_out() {
    let mut d = sample();
    for e in d.ladder.iter_mut().flat_map(|r| r.training.iter_mut().chain(&mut r.held_out)) {
        (e.attitude_rad, e.rate_rad_s) = (1.3e-15, 0.0);
    }
    for lack in d.ladder.iter_mut().flat_map(|r| [&mut r.training_lack, &mut r.held_out_lack]).flatten() {
        (lack.torque_n_m, lack.torque_times_noise) = (None, None);
    }
    let words = text(&d);
    assert!(!words.contains("10⁻¹⁵") && !words.contains("body rate"), "{words}");
    let page = Report::of(d.clone()).html();
    let (markup, _) = take_apart(&page);
    assert!(!markup.contains("attitude after") && !markup.contains("10⁻¹⁵"));
    assert!(!serde_json::to_string(&d).expect("JSON").contains("e-15"));
    keep("ladder_fed_in.png", &ladder_png(&d).expect("the picture can be drawn"));
}

/// The card says what the headline says: one of several only where one of them is missing for certain.
#[test]
fn what_may_be_one_of_several_or_nothing_is_shown_as_not_certain() {
    let shown = |said: Said| {
        let mut d = sample();
        d.findings[1].second.said = said;
        let (markup, _) = take_apart(&Report::of(d.clone()).html());
        ["one of several", "not certain"].map(|word| {
            let tag = format!("<span class=\"tag doubt\">{word}</span>");
            assert_eq!(
                markup.contains(&tag),
                unwrapped(&text(&d)).contains(&format!("(drive, {word})")),
                "{word}"
            );
            markup.contains(&tag)
        })
    };
    assert_eq!(shown(Said::Agrees), [true, false]);
    assert_eq!(shown(Said::Answer), [false, true]);
}

#[test]
fn what_harms_on_unseen_flight_is_shown_as_doubtful() {
    let mut d = sample();
    let told = "the force error on unseen flight rises from 41.0 to 44.0 mN with it: not written";
    let doubt = |h: HeldOut| HeldOut { written: false, doubt: Some(told.into()), ..h };
    d.findings[0].held_out = d.findings[0].held_out.take().map(doubt);
    let words = text(&d);
    assert!(
        words.contains("in doubt, not written") && words.contains("rises from 41.0 to 44.0 mN"),
        "{words}"
    );
    let (markup, _) = take_apart(&Report::of(d).html());
    assert!(markup.contains("in doubt, not written") && markup.contains("rises from 41.0 to 44.0 mN"));
}

#[test]
fn a_number_far_outside_its_tolerance_is_not_called_within_it() {
    let mut d = sample();
    d.calibration[0].tolerance = 0.0005;
    let words = text(&d);
    assert!(words.contains("Outside tolerance") && words.contains("5.4 tolerances off"), "{words}");
    assert!(!words.contains("within manufacturing tolerance"), "{words}");
    d.calibration[0].tolerance = 0.01;
    assert!(text(&d).contains("within manufacturing tolerance"));
    // One that fits better is told so, and not as worse by a negative number.
    d.findings[1].look_alikes[0].worse_by_nats = -4.9;
    let words = text(&d);
    assert!(unwrapped(&words).contains("fits better by 4.9 nats, less plausible"), "{words}");
    d.findings[1].look_alikes[0].worse_by_nats = 0.04;
    let words = unwrapped(&text(&d));
    assert!(words.contains("fits as well") && !words.contains("by 0.04"), "{words}");
}
