//! Vehicle files with effects put in and taken out.

use super::*;
use propwash_vehicle::{BUILTIN, diff};

fn base() -> &'static str {
    Vehicle::builtin_file("cf2x_L250").unwrap()
}

fn source() -> Source {
    Source { log_sha256: vec!["ab".repeat(32)], date: "2025-01-31".into(), text: "flight 7, propwash".into() }
}

fn fit(kind: &str, models: Option<&[&str]>, parameters: &[(&str, f64, f64)]) -> FittedEffect {
    FittedEffect {
        kind: kind.into(),
        models: models.map(|m| m.iter().map(|m| m.to_string()).collect()),
        parameters: parameters
            .iter()
            .map(|(name, value, sigma)| FittedParameter {
                name: name.to_string(),
                value: *value,
                sigma: *sigma,
            })
            .collect(),
        note: None,
    }
}

fn added(text: &str, effect: FittedEffect) -> String {
    add(text, "test", &[effect], &source()).unwrap()
}

fn vehicle(text: &str) -> Vehicle {
    Vehicle::from_toml("test", text).unwrap()
}

/// Value of a parameter of an effect in the simulated drone, for one dynamics.
fn flown(text: &str, dynamics: &str, kind: &str, name: &str) -> Option<f64> {
    let drone = vehicle(text).drone(dynamics).unwrap();
    let effect = drone.effects.iter().find(|e| e.kind() == kind)?;
    named_parameters(effect).into_iter().find(|(n, _)| n == name).map(|(_, v)| v)
}

#[test]
fn an_added_effect_flies_and_the_rest_of_the_file_stays_byte_for_byte() {
    for name in BUILTIN {
        let text = Vehicle::builtin_file(name).unwrap();
        let effect = FittedEffect {
            note: Some("hover and steps".into()),
            ..fit("payload", None, &[("mass_kg", 0.0041, 0.0002), ("position_m.2", -0.03, 0.004)])
        };
        let out = added(text, effect);
        let tail = out.strip_prefix(text).unwrap();
        assert_eq!(
            tail,
            format!(
                "\n[[effect]]\nkind = \"payload\"\nmass_kg = 0.0041\nposition_m = [0.0, 0.0, -0.03]\n\
                 sigma = {{ mass_kg = 2e-4, position_m.2 = 0.004 }}\nsource = \"flight 7, propwash\"\n\
                 source_log_sha256 = \"{}\"\ndate = \"2025-01-31\"\nnote = \"hover and steps\"\n",
                "ab".repeat(32)
            )
        );
        for dynamics in DYNAMICS {
            assert_eq!(flown(&out, dynamics, "payload", "position_m.2"), Some(-0.03));
        }
        let vehicle = vehicle(&out);
        let mass = vehicle.provenance().into_iter().find(|p| p.key == "effect.1.mass_kg").unwrap();
        assert_eq!(mass.sigma.unwrap().as_float(), Some(2e-4));
        assert_eq!(
            mass.source.unwrap(),
            format!("flight 7, propwash; fitted to the log of sha256 {} on 2025-01-31", "ab".repeat(32))
        );
        // And out again: the file is what it was.
        assert_eq!(remove(&out, "test", "payload").unwrap(), text);
    }
}

#[test]
fn every_kind_of_effect_can_be_added_updated_and_removed() {
    for kind in propwash_physics::effects::KINDS {
        let names = named_parameters(&AnyEffect::by_kind(kind).unwrap());
        for (name, default) in &names {
            let value = default + 0.01 * default.abs().max(0.1);
            let out = added(base(), fit(kind, Some(&["first_principles"]), &[(name, value, 0.01)]));
            assert_eq!(flown(&out, "first_principles", kind, name), Some(value), "{kind}.{name}\n{out}");
            assert_eq!(flown(&out, "so_rpy", kind, name), None, "{kind}");
            // The second fit moves the number and leaves one entry.
            let again = added(&out, fit(kind, Some(&["first_principles"]), &[(name, value * 1.001, 0.02)]));
            assert_eq!(flown(&again, "first_principles", kind, name), Some(value * 1.001));
            assert_eq!(vehicle(&again).file().effect.len(), vehicle(&out).file().effect.len());
            let gone = remove(&again, "test", kind).unwrap();
            assert!(vehicle(&gone).file().effect.iter().all(|e| e.kind != *kind));
        }
    }
}

#[test]
fn values_read_back_bit_for_bit() {
    let mut value = 1.0;
    for i in 0..200 {
        value = (value * 0.37 + f64::from(i)) % 7.3 * 10f64.powi(i % 19 - 9) + 1e-12;
        let out = added(base(), fit("motor_lag", None, &[("spin_up_factor", value, value)]));
        assert_eq!(flown(&out, "so_rpy", "motor_lag", "spin_up_factor").unwrap().to_bits(), value.to_bits());
    }
}

#[test]
fn a_matrix_is_updated_in_its_layout_and_keeps_what_was_not_fitted() {
    let text = base().replace(
        "    [0.0, 0.014953790232821078, 0.0],\n",
        "    [0.0, 0.014953790232821078, 0.001],  # measured once\n",
    );
    let models = ["first_principles", "so_rpy_rotor_drag"];
    let out = added(
        &text,
        fit(
            "linear_drag",
            Some(&models),
            &[("drag_n_s_per_m.0.0", 0.02, 0.001), ("drag_n_s_per_m.2.2", 0.03, f64::NAN)],
        ),
    );
    let want = text
        .replace("[0.014953790232821078, 0.0, 0.0]", "[0.02, 0.0, 0.0]")
        .replace("[0.0, 0.0, 0.013900090000325344]", "[0.0, 0.0, 0.03]");
    let (head, tail) = want.split_at(
        want.find("source = \"Crazyflow 0.4.0, dynamics/so_rpy_rotor_drag/params.toml [cf2x_L250] (drag")
            .unwrap(),
    );
    let rest = out.strip_prefix(head).unwrap();
    let old = tail.split('"').nth(1).unwrap();
    assert!(
        rest.starts_with(&format!(
            "source = \"flight 7, propwash (drag_n_s_per_m.0.0, drag_n_s_per_m.2.2); the rest: {old}\"\n"
        )),
        "{rest}"
    );
    assert!(rest.contains("note = \"Identified together"), "what stays keeps its note: {rest}");
    assert!(rest.contains("sigma = { drag_n_s_per_m.0.0 = 0.001 }"), "{rest}");
    // A fit of everything that is not 0 replaces source, log and note.
    let whole: Vec<(String, f64, f64)> = [(0, 0), (1, 1), (1, 2), (2, 2)]
        .map(|(i, j)| (format!("drag_n_s_per_m.{i}.{j}"), 0.05, 0.002))
        .to_vec();
    let whole: Vec<(&str, f64, f64)> = whole.iter().map(|(n, v, s)| (n.as_str(), *v, *s)).collect();
    let other =
        Source { log_sha256: vec!["1".repeat(64), "2".repeat(64)], text: "two flights".into(), ..source() };
    let out = add(&out, "test", &[fit("linear_drag", Some(&models), &whole)], &other).unwrap();
    let entry = vehicle(&out).file().effect[0].clone();
    assert_eq!(entry.source.as_deref(), Some("two flights"));
    assert_eq!(entry.source_log_sha256.as_ref().unwrap().as_slice(), ["1".repeat(64), "2".repeat(64)]);
    assert_eq!(entry.note, None);
    assert!(out.contains("0.05],  # measured once"), "{out}");
    assert_eq!(
        entry.sigma["drag_n_s_per_m"].to_string(),
        "{ 0 = { 0 = 0.002 }, 1 = { 1 = 0.002, 2 = 0.002 }, 2 = { 2 = 0.002 } }"
    );
    // All nine: a matrix of sigmas.
    let nine: Vec<(String, f64, f64)> =
        (0..9).map(|k| (format!("drag_n_s_per_m.{}.{}", k / 3, k % 3), 0.01, 0.003)).collect();
    let nine: Vec<(&str, f64, f64)> = nine.iter().map(|(n, v, s)| (n.as_str(), *v, *s)).collect();
    let out = added(&out, fit("linear_drag", Some(&models), &nine));
    assert!(vehicle(&out).file().effect[0].sigma["drag_n_s_per_m"].is_array(), "{out}");
}

#[test]
fn sigmas_in_a_table_of_their_own_are_kept_and_updated() {
    let text = format!(
        "{}\n[[effect]]\nkind = \"weak_rotor\"\nfactor = [1, 1, 0.9, 1, 1, 1, 1, 1]  # third\n\n[effect.sigma]\n# by index\nfactor.2 = 0.01\n\n\
         [[effect]]\nkind = \"command_delay\"\ndelay_s = 0.01\n",
        base()
    );
    let out = added(&text, fit("weak_rotor", None, &[("factor.0", 0.95, 0.02)]));
    let entries = vehicle(&out).file().effect.clone();
    assert_eq!(entries[1].sigma["factor"].to_string(), "{ 0 = 0.02, 2 = 0.01 }");
    assert!(out.contains("factor = [0.95, 1, 0.9, 1, 1, 1, 1, 1]  # third\n"), "{out}");
    assert!(entries[2].sigma.is_empty());
    // Splitting an entry with a sigma table gives each part its own.
    let out = added(&text, fit("weak_rotor", Some(&["so_rpy"]), &[("factor.2", 0.8, 0.03)]));
    let entries = vehicle(&out).file().effect.clone();
    let kinds: Vec<&str> = entries.iter().map(|e| e.kind.as_str()).collect();
    assert_eq!(kinds, ["linear_drag", "weak_rotor", "weak_rotor", "command_delay"]);
    assert_eq!(entries[1].sigma["factor"].to_string(), "{ 2 = 0.01 }", "{out}");
    assert_eq!(entries[2].sigma["factor"].to_string(), "{ 2 = 0.03 }", "{out}");
    assert_eq!(flown(&out, "so_rpy", "weak_rotor", "factor.2"), Some(0.8));
    for other in ["first_principles", "so_rpy_rotor", "so_rpy_rotor_drag"] {
        assert_eq!(flown(&out, other, "weak_rotor", "factor.2"), Some(0.9));
    }
}

#[test]
fn a_fit_for_some_dynamics_leaves_the_others_as_they_are() {
    let fitted = fit("linear_drag", Some(&["first_principles"]), &[("drag_n_s_per_m.0.0", 0.5, 0.1)]);
    let out = added(base(), fitted);
    assert_eq!(flown(&out, "first_principles", "linear_drag", "drag_n_s_per_m.0.0"), Some(0.5));
    assert_eq!(
        flown(&out, "first_principles", "linear_drag", "drag_n_s_per_m.1.1"),
        Some(0.014953790232821078)
    );
    assert_eq!(
        flown(&out, "so_rpy_rotor_drag", "linear_drag", "drag_n_s_per_m.0.0"),
        Some(0.014953790232821078)
    );
    let d = diff(&vehicle(base()), &vehicle(&out));
    assert_eq!((d.effects.len(), d.parameters.len()), (1, 0), "{d:?}");
    assert_eq!(d.effects[0].dynamics, ["first_principles"]);
    assert_eq!(d.effects[0].parameters.len(), 1);
    // For all dynamics: the only entry is extended to those that had none.
    let out = added(base(), fit("linear_drag", None, &[("drag_n_s_per_m.0.0", 0.5, 0.1)]));
    let file = vehicle(&out);
    assert_eq!((file.file().effect.len(), &file.file().effect[0].models), (1, &None));
    // For one that has none: so does the entry, with the values of all its dynamics untouched.
    let out = added(base(), fit("linear_drag", Some(&["so_rpy"]), &[("drag_n_s_per_m.0.0", 0.5, 0.1)]));
    assert_eq!(vehicle(&out).file().effect.len(), 2);
    assert_eq!(flown(&out, "so_rpy", "linear_drag", "drag_n_s_per_m.1.1"), Some(0.0));
    assert_eq!(
        flown(&out, "first_principles", "linear_drag", "drag_n_s_per_m.0.0"),
        Some(0.014953790232821078)
    );
}

#[test]
fn effects_stand_where_effects_stand_and_inline_lists_become_tables() {
    let drag = base().find("[[effect]]").unwrap();
    let (body, effect) = base().split_at(drag);
    let start = body.find("[rates]").unwrap();
    let (before, rates) = body.split_at(start);
    // Effects in the middle of the file, the rates behind them.
    let middle = format!("{before}{effect}\n{rates}# the end\n");
    let out = added(&middle, fit("command_delay", None, &[("delay_s", 0.012, 0.001)]));
    let place = |what: &str| out.find(what).unwrap();
    assert!(
        place("linear_drag") < place("command_delay") && place("command_delay") < place("[rates]"),
        "{out}"
    );
    assert!(out.ends_with("# the end\n"));
    assert_eq!(remove(&out, "test", "command_delay").unwrap(), middle);
    // None at all.
    let out = added(body, fit("command_delay", None, &[("delay_s", 0.012, 0.001)]));
    assert!(out.starts_with(body) && out.contains("delay_s = 0.012"), "{out}");
    let gone = remove(&out, "test", "command_delay").unwrap();
    assert_eq!(gone.trim_end(), body.trim_end());
    for list in [
        "effect = []\n",
        "effect = [{ kind = \"command_delay\", delay_s = 0.1, sigma = { delay_s = 0.2 } }]\n",
    ] {
        let out = added(&format!("{list}{body}"), fit("command_delay", None, &[("delay_s", 0.012, 0.001)]));
        assert_eq!(vehicle(&out).file().effect.len(), 1, "{out}");
        assert_eq!(flown(&out, "so_rpy", "command_delay", "delay_s"), Some(0.012));
    }
}

#[test]
fn removing_an_effect_leaves_the_comments_that_are_not_its_own() {
    let head = "# What acts on it beside rotors.\n\n# Drag of the frame.\n";
    let text = base().replace("[[effect]]", &format!("{head}[[effect]]"));
    let more = format!(
        "{text}\n# Late.\n[[effect]]\nkind = \"command_delay\"\n# guessed\ndelay_s = 0.01\n\n# bye\n"
    );
    let out = remove(&more, "test", "linear_drag").unwrap();
    assert!(out.contains("\n# What acts on it beside rotors.\n\n# Late.\n[[effect]]\n"), "{out}");
    assert!(
        !out.contains("Drag of the frame") && out.contains("# guessed\n") && out.ends_with("\n\n# bye\n"),
        "{out}"
    );
    let out = remove(&more, "test", "command_delay").unwrap();
    assert!(!out.contains("# Late.") && out.ends_with("\n# bye\n"), "{out}");
    let out = remove(&remove(&more, "test", "linear_drag").unwrap(), "test", "command_delay").unwrap();
    assert!(
        out.contains("# What acts on it beside rotors.\n") && vehicle(&out).file().effect.is_empty(),
        "{out}"
    );
    let error = remove(&out, "mine.toml", "payload").unwrap_err().to_string();
    assert_eq!(error, "mine.toml: expected the effect `payload`, found no effects; correct the name");
    let error = remove(&more, "mine.toml", "payload").unwrap_err().to_string();
    assert!(error.contains("found linear_drag, command_delay"), "{error}");
}

#[test]
fn fits_that_cannot_stand_in_a_file_are_refused_in_words() {
    let refused = |effect: FittedEffect, source: Source, words: &[&str]| {
        let error = add(base(), "mine.toml", &[effect], &source).unwrap_err().to_string();
        for word in words {
            assert!(error.contains(word), "no {word:?} in {error}");
        }
    };
    let mass = |value: f64, sigma: f64| fit("payload", None, &[("mass_kg", value, sigma)]);
    refused(
        mass(-0.01, 0.1),
        source(),
        &["payload", "mass_kg = -0.01", "a number from 0", "leave this effect out"],
    );
    refused(mass(f64::NAN, 0.1), source(), &["mass_kg", "finite", "NaN"]);
    refused(mass(0.1, 0.0), source(), &["mass_kg", "above 0", "found 0"]);
    refused(mass(0.1, f64::INFINITY), source(), &["mass_kg", "above 0", "inf"]);
    refused(fit("payload", None, &[]), source(), &["payload", "at least one parameter"]);
    refused(fit("payload", None, &[("mas_kg", 1.0, 1.0)]), source(), &["mas_kg", "mass_kg, position_m.0"]);
    refused(fit("payload", None, &[("mass_kg", 1.0, 1.0), ("mass_kg", 2.0, 1.0)]), source(), &["twice"]);
    refused(
        fit("paylod", None, &[("mass_kg", 1.0, 1.0)]),
        source(),
        &["kind", "payload", "correct the name"],
    );
    refused(
        fit("payload", Some(&["so"]), &[("mass_kg", 1.0, 1.0)]),
        source(),
        &["models", "so_rpy", "found so"],
    );
    refused(fit("payload", Some(&[]), &[("mass_kg", 1.0, 1.0)]), source(), &["models", "at least one"]);
    refused(
        mass(0.1, 0.1),
        Source { log_sha256: vec!["xyz".into()], ..source() },
        &["log hash", "64", "`xyz`"],
    );
    for date in ["31.1.2025", "2025-13-01", "2025-1-1", ""] {
        refused(mass(0.1, 0.1), Source { date: date.into(), ..source() }, &["date", "2025-01-31"]);
    }
    let error = add("[body]\n", "mine.toml", &[mass(0.1, 0.1)], &source()).unwrap_err().to_string();
    assert!(error.starts_with("mine.toml") && error.contains("missing field"), "{error}");
    // The file's value and the fitted one are checked together.
    let out = added(base(), fit("motor_lag", None, &[("spin_up_factor", 1.2, 0.1)]));
    let error =
        add(&out, "x", &[fit("motor_lag", None, &[("spin_down_factor", 0.0, 0.1)])], &source()).unwrap_err();
    assert!(error.to_string().contains("spin_down_factor = 0"), "{error}");
}

#[test]
fn files_are_replaced_only_when_forced_and_then_whole() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("v.toml");
    write(&path, "one", false).unwrap();
    let error = write(&path, "two", false).unwrap_err().to_string();
    assert!(error.contains("v.toml") && error.contains("--force") && error.contains("--out"), "{error}");
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "one");
    assert!(may_write(&path, false).is_err() && may_write(&path, true).is_ok());
    write(&path, "two", true).unwrap();
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "two");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "nothing is left beside it");
    write(&dir.path().join("new.toml"), "three", true).unwrap();
    for force in [false, true] {
        let error = write(dir.path(), "x", force).unwrap_err().to_string();
        assert!(error.contains("a folder"), "{error}");
        let error = write(&dir.path().join("no/v.toml"), "x", force).unwrap_err().to_string();
        assert!(error.contains("no/v.toml") && error.contains("cannot be written"), "{error}");
    }
}

#[test]
fn dates_are_those_of_the_calendar() {
    // Reference: `date -u -d @SECONDS +%F` of GNU coreutils.
    for (unix_s, date) in [
        (0, "1970-01-01"),
        (86_399, "1970-01-01"),
        (951_782_400, "2000-02-29"),
        (1_709_164_800, "2024-02-29"),
        (1_735_603_200, "2024-12-31"),
        (1_735_689_600, "2025-01-01"),
        (4_107_542_400, "2100-03-01"),
    ] {
        assert_eq!(date_utc(unix_s), date);
    }
    assert!(is_date(&today_utc()) && is_date("2025-01-31T12:00:00Z"));
}
