//! The mapping screen: foreign columns get our names, units and signs, and the text of a mapping file comes of it.

use std::fmt::Write as _;

use serde::{Deserialize, Serialize};

use crate::flight::peek::{FileColumn, Peek};

/// What a person chose for one column.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Row {
    /// Name in the file.
    pub from: String,
    /// Our name, or `roll`, `pitch`, `yaw` of the attitude.
    pub ours: String,
    /// Unit in the file.
    #[serde(default)]
    pub unit: String,
    /// Whether its sign is changed.
    #[serde(default)]
    pub negative: bool,
}

/// All of it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Choice {
    /// Columns that are used.
    pub rows: Vec<Row>,
    /// Frame of the world: `z_up`, `ned`, `y_up`.
    #[serde(default)]
    pub world_frame: String,
    /// Frame of the body: `flu`, `frd`.
    #[serde(default)]
    pub body_frame: String,
    /// Between the cells of a text file, where it is no comma.
    #[serde(default)]
    pub delimiter: Option<char>,
}

/// Attitude as angles.
const ANGLES: [&str; 3] = ["roll", "pitch", "yaw"];

/// A TOML string: JSON's escapes are TOML's too.
fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

impl Choice {
    /// The text of the mapping file.
    ///
    /// # Errors
    /// In words, where a name is given twice or only some of the angles are there.
    pub fn toml(&self) -> Result<String, String> {
        for (i, row) in self.rows.iter().enumerate() {
            if let Some(other) = self.rows[..i].iter().find(|other| other.ours == row.ours) {
                return Err(format!(
                    "`{}` and `{}` are both called {}: choose another name for one of them",
                    other.from, row.from, row.ours
                ));
            }
        }
        let mut out = String::from("# Written by propwash lab: our names, and what the file calls them.\n");
        if let Some(delimiter) = self.delimiter.filter(|d| *d != ',') {
            let _ = writeln!(out, "delimiter = {}", quoted(&delimiter.to_string()));
        }
        for (key, frame, plain) in
            [("world_frame", &self.world_frame, "z_up"), ("body_frame", &self.body_frame, "flu")]
        {
            if !frame.is_empty() && frame != plain {
                let _ = writeln!(out, "{key} = {}", quoted(frame));
            }
        }
        out.push_str("\n[columns]\n");
        for row in self.rows.iter().filter(|r| !ANGLES.contains(&r.ours.as_str())) {
            let mut source = format!("from = {}", quoted(&row.from));
            if !row.unit.is_empty() {
                let _ = write!(source, ", unit = {}", quoted(&row.unit));
            }
            if row.negative {
                source.push_str(", scale = -1.0");
            }
            let _ = writeln!(out, "{} = {{ {source} }}", quoted(&row.ours));
        }
        let angles: Vec<&Row> =
            ANGLES.iter().filter_map(|a| self.rows.iter().find(|r| r.ours == *a)).collect();
        match angles.as_slice() {
            [] => {}
            [roll, pitch, yaw] => {
                if roll.unit != pitch.unit || roll.unit != yaw.unit {
                    return Err("roll, pitch and yaw are in different units: give them one".into());
                }
                let names = [roll, pitch, yaw].map(|r| quoted(&r.from)).join(", ");
                let signs = [roll, pitch, yaw].map(|r| if r.negative { "-1.0" } else { "1.0" }).join(", ");
                let unit = if roll.unit.is_empty() { "rad" } else { &roll.unit };
                let _ = writeln!(
                    out,
                    "\n[attitude]\neuler = [{names}]\nunit = {}\nsigns = [{signs}]",
                    quoted(unit)
                );
            }
            some => {
                let there: Vec<&str> = some.iter().map(|r| r.ours.as_str()).collect();
                return Err(format!(
                    "an attitude takes roll, pitch and yaw; there is only {}",
                    there.join(" and ")
                ));
            }
        }
        Ok(out)
    }

    /// What the names and the ranges of the columns suggest; the person decides.
    pub fn suggested(seen: &Peek) -> Self {
        let mut rows: Vec<Row> = Vec::new();
        for column in seen.columns.iter().filter(|c| c.numbers > 0) {
            let Some(ours) = meant(&column.name) else { continue };
            if rows.iter().all(|r| r.ours != ours) {
                rows.push(Row { from: column.name.clone(), ours, unit: String::new(), negative: false });
            }
        }
        // Angles go together, and a quaternion goes before them.
        let has = |name: &str, rows: &[Row]| rows.iter().any(|r| r.ours == name);
        if !ANGLES.iter().all(|a| has(a, &rows)) || has("qw", &rows) {
            rows.retain(|r| !ANGLES.contains(&r.ours.as_str()));
        }
        let of = |row: &Row| seen.columns.iter().find(|c| c.name == row.from);
        let groups: Vec<(Vec<&FileColumn>, Vec<usize>)> = GROUPS
            .iter()
            .map(|group| {
                let own: Vec<usize> = (0..rows.len()).filter(|i| in_group(group, &rows[*i].ours)).collect();
                (own.iter().filter_map(|i| of(&rows[*i])).collect(), own)
            })
            .collect();
        for (group, (columns, own)) in GROUPS.iter().zip(groups) {
            let unit = unit(group, &columns);
            for i in own {
                rows[i].unit = unit.into();
                // Crazyflie's pitch turns the other way (firmware, stateEstimate.pitch).
                rows[i].negative = rows[i].ours == "pitch" && rows[i].from.starts_with("stateEstimate");
            }
        }
        Self { rows, delimiter: seen.delimiter, ..Self::default() }
    }
}

/// Columns that share a unit.
const GROUPS: &[&str] =
    &["t", "p", "v", "w", "a", "angle", "rotor", "cmd_rotor", "force", "vbat", "ref_", "cmd_u"];

fn in_group(group: &str, ours: &str) -> bool {
    let axis = |prefix: &str| ours.strip_prefix(prefix).is_some_and(|rest| matches!(rest, "x" | "y" | "z"));
    match group {
        "p" | "v" | "w" | "a" => axis(group),
        "ref_" => axis("ref_"),
        "angle" => ANGLES.contains(&ours) || matches!(ours, "cmd_roll" | "cmd_pitch" | "cmd_yaw"),
        "force" => matches!(ours, "thrust" | "cmd_thrust"),
        "rotor" | "cmd_rotor" | "cmd_u" => ours
            .strip_prefix(group)
            .is_some_and(|rest| !rest.is_empty() && rest.bytes().all(|b| b.is_ascii_digit())),
        exact => ours == exact,
    }
}

/// The unit that the size of the numbers suggests.
fn unit(group: &str, columns: &[&FileColumn]) -> &'static str {
    let most =
        columns.iter().flat_map(|c| [c.least, c.greatest]).flatten().fold(0.0, |m: f64, v| m.max(v.abs()));
    let means = columns.iter().filter_map(|c| c.mean).map(|m| m * m).sum::<f64>().sqrt();
    match group {
        // From 1 ms to 0.2 s between rows.
        "t" => match columns.first().and_then(|c| c.step) {
            Some(step) if step > 2e5 => "ns",
            Some(step) if step > 200.0 => "us",
            Some(step) if step > 0.3 => "ms",
            _ => "s",
        },
        "p" | "ref_" if most > 60.0 => "mm",
        "p" | "ref_" => "m",
        "v" if most > 60.0 => "mm/s",
        "v" => "m/s",
        "w" if most > 35.0 => "deg/s",
        "w" => "rad/s",
        // The mean is about gravity.
        "a" if means > 2000.0 => "mm/s2",
        "a" if means < 3.0 => "g",
        "a" => "m/s2",
        "angle" if most > 7.0 => "deg",
        "angle" => "rad",
        "rotor" | "cmd_rotor" if most > 6000.0 => "rpm",
        "rotor" | "cmd_rotor" => "rad/s",
        "force" => "N",
        "vbat" if most > 100.0 => "mV",
        "vbat" => "V",
        "cmd_u" if most > 200.0 => "uint16",
        "cmd_u" if most > 1.5 => "percent",
        _ => "1",
    }
}

/// Our name for what a column of another program is called, by its words.
fn meant(name: &str) -> Option<String> {
    let lower = name.to_ascii_lowercase();
    let words: String = lower.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '.' }).collect();
    let parts: Vec<&str> = words.split('.').filter(|p| !p.is_empty()).collect();
    let (last, rest) = parts.split_last()?;
    let about = |needles: &[&str]| rest.iter().any(|p| needles.iter().any(|n| p.contains(n)));
    if crate::flight::peek::contract(16).iter().any(|c| c.name == lower) {
        return Some(lower);
    }
    if matches!(*last, "time" | "timestamp" | "tick" | "stamp" | "us" | "ms" | "sec" | "secs")
        && (rest.is_empty() || about(&["time"]))
    {
        return Some("t".into());
    }
    for (angle, all) in [("roll", ["roll", "phi"]), ("pitch", ["pitch", "theta"]), ("yaw", ["yaw", "psi"])] {
        if all.contains(last) {
            return Some(if about(&["cmd", "ctrl", "target", "sp", "des"]) {
                format!("cmd_{angle}")
            } else {
                angle.to_string()
            });
        }
    }
    for q in ["qx", "qy", "qz", "qw"] {
        if *last == q || (about(&["quat", "orientation", "q"]) && *last == &q[1..]) {
            return Some(q.into());
        }
    }
    if let Some(n) = last.strip_prefix('m').or(last.strip_prefix("rpm")).or(last.strip_prefix("motor"))
        && n.len() == 1
        && n.bytes().all(|b| b.is_ascii_digit())
    {
        let n = if words.contains("m0") { n.parse::<usize>().ok()? + 1 } else { n.parse().ok()? };
        return (n > 0).then(|| {
            if about(&["rpm"]) || words.contains("rpm") {
                format!("rotor{n}")
            } else {
                format!("cmd_rotor{n}")
            }
        });
    }
    let axis = last.chars().last().filter(|c| matches!(c, 'x' | 'y' | 'z'))?;
    let stem = &last[..last.len() - 1];
    let letter = match (
        stem,
        about(&["gyro", "rate", "angvel", "angular", "omega"]),
        about(&["acc"]),
        about(&["vel"]),
    ) {
        (_, true, _, _) | ("w" | "gyro" | "gyr" | "omega", ..) => "w",
        (_, _, true, _) | ("a" | "acc" | "accel", ..) => "a",
        (_, _, _, true) | ("v" | "vel", ..) => "v",
        ("" | "p" | "pos", ..) if about(&["ref", "target", "ctrl", "setpoint", "des"]) => "ref_",
        ("" | "p" | "pos", ..) => "p",
        _ => return None,
    };
    Some(format!("{letter}{axis}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn column(name: &str, least: f64, greatest: f64, mean: f64, step: f64) -> FileColumn {
        FileColumn {
            name: name.into(),
            numbers: 9,
            least: Some(least),
            greatest: Some(greatest),
            mean: Some(mean),
            step: Some(step),
            ..FileColumn::default()
        }
    }

    #[test]
    fn crazyflie_names_in_mm_and_degrees_are_suggested_as_they_are_meant() {
        let mut columns = vec![column("timestamp", 0.0, 5e4, 2.5e4, 10.0)];
        for axis in ["x", "y", "z"] {
            columns.push(column(&format!("stateEstimateZ.{axis}"), -1500.0, 1500.0, 0.0, 1.0));
            columns.push(column(&format!("stateEstimateZ.v{axis}"), -1800.0, 1700.0, 0.0, 1.0));
            columns.push(column(&format!("gyro.{axis}"), -200.0, 150.0, 0.0, 1.0));
            columns.push(column(&format!("acc.{axis}"), -1.0, 2.0, if axis == "z" { 1.0 } else { 0.0 }, 1.0));
        }
        for angle in ["roll", "pitch", "yaw"] {
            columns.push(column(&format!("stateEstimate.{angle}"), -30.0, 30.0, 0.0, 1.0));
        }
        columns.push(column("pm.state", 0.0, 1.0, 0.0, 1.0));
        let seen = Peek { delimiter: Some(','), columns, rows: 9, more: false };
        let choice = Choice::suggested(&seen);
        let row = |ours: &str| {
            choice
                .rows
                .iter()
                .find(|r| r.ours == ours)
                .map(|r| (r.from.as_str(), r.unit.as_str(), r.negative))
        };
        assert_eq!(row("t"), Some(("timestamp", "ms", false)));
        assert_eq!(row("px"), Some(("stateEstimateZ.x", "mm", false)));
        assert_eq!(row("vz"), Some(("stateEstimateZ.vz", "mm/s", false)));
        assert_eq!(row("wy"), Some(("gyro.y", "deg/s", false)));
        assert_eq!(row("az"), Some(("acc.z", "g", false)));
        assert_eq!(row("pitch"), Some(("stateEstimate.pitch", "deg", true)));
        assert!(choice.rows.iter().all(|r| r.from != "pm.state"));
        let text = choice.toml().unwrap();
        crate::flight::Mapping::parse(&text, "m.toml".as_ref()).unwrap();
        assert!(text.contains("signs = [1.0, -1.0, 1.0]"), "{text}");
    }

    #[test]
    fn names_with_quotes_and_tags_stay_names() {
        let row = |from: &str, ours: &str| Row {
            from: from.into(),
            ours: ours.into(),
            unit: "m".into(),
            negative: true,
        };
        let choice = Choice {
            rows: vec![row("a\"]\n[x", "px"), row("<script>", "py"), row("z", "pz")],
            ..Choice::default()
        };
        let text = choice.toml().unwrap();
        crate::flight::Mapping::parse(&text, "m.toml".as_ref()).unwrap();
        assert!(text.contains(r#"from = "a\"]\n[x""#), "{text}");
        let twice = Choice { rows: vec![row("a", "px"), row("b", "px")], ..Choice::default() };
        assert!(twice.toml().unwrap_err().contains("both called px"));
        let some = Choice { rows: vec![row("a", "roll"), row("b", "yaw")], ..Choice::default() };
        assert!(some.toml().unwrap_err().contains("only roll and yaw"));
    }
}
