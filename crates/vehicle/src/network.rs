//! `[[effect]]` entries of kind `network` and the files beside the vehicle file that they name; `docs/effects/network.md`.
//!
//! An entry names its file and that file's SHA-256. The content of every network that was read or made is known by its hash for as
//! long as the program runs, so that the text of a vehicle file alone can be read again; [`Vehicle::to_toml`](super::Vehicle::to_toml)
//! holds the content itself and stands alone.

use super::error::VehicleError;
use super::expression::is_identifier;
use super::file::Check;
use super::schema::{EffectEntry, VehicleFile};
use propwash_physics::effects::network::{
    ACTS_ON, Layer, MAX_WEIGHTS, Mlp, Network, Params, Scaling, inputs,
};
use propwash_physics::effects::{AnyEffect, kinds};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// Kind of these entries.
pub(super) const KIND: &str = "network";
/// First line of a network's file after its comment: what it is.
const FORMAT: &str = "propwash network 1";

/// Contents of network files by their SHA-256.
static CONTENTS: Mutex<BTreeMap<String, String>> = Mutex::new(BTreeMap::new());

/// SHA-256 (hex) of a text.
pub fn sha256_of(text: &str) -> String {
    Sha256::digest(text.as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Keeps the content of a network file for as long as the program runs, so that texts of vehicle files may name it; returns its
/// SHA-256.
pub fn keep(content: &str) -> String {
    let hash = sha256_of(content);
    let mut known = CONTENTS.lock().unwrap_or_else(PoisonError::into_inner);
    known.entry(hash.clone()).or_insert_with(|| content.to_string());
    hash
}

/// The content of a network file that was read, or kept by [`keep`].
pub fn kept(sha256: &str) -> Option<String> {
    CONTENTS.lock().unwrap_or_else(PoisonError::into_inner).get(sha256).cloned()
}

/// The network with this content, kept once for as long as the program runs.
pub fn intern(network: Network) -> &'static Network {
    static KNOWN: Mutex<Vec<&'static Network>> = Mutex::new(Vec::new());
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(same) = known.iter().find(|n| ***n == network) {
        return same;
    }
    let kept: &'static Network = Box::leak(Box::new(network));
    known.push(kept);
    kept
}

/// Names and contents of the network files that the text of a vehicle file needs beside it; nothing for entries that hold their
/// content, and for texts that are no vehicle file.
pub fn files_of(text: &str) -> Vec<(String, String)> {
    let Ok(file) = toml::from_str::<VehicleFile>(text) else { return Vec::new() };
    let one = |entry: &EffectEntry| {
        let of = |key: &str| entry.params.get(key).and_then(toml::Value::as_str);
        let needs = entry.kind == KIND && of("content").is_none();
        let (name, hash) = (of("file").filter(|_| needs)?, of("sha256")?);
        Some((name.to_string(), kept(hash)?))
    };
    file.effect.iter().filter_map(one).collect()
}

/// A network as its file holds it.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct NetworkFile {
    format: String,
    input: Vec<InputTable>,
    hidden: Vec<LayerTable>,
    output: OutputTable,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct InputTable {
    name: String,
    unit: String,
    offset: f64,
    scale: f64,
    low: f64,
    high: f64,
    margin: f64,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct LayerTable {
    weight: Vec<Vec<f64>>,
    bias: Vec<f64>,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct OutputTable {
    acts_on: Vec<String>,
    weight: Vec<Vec<f64>>,
    bias: Vec<f64>,
}

impl From<LayerTable> for Layer {
    fn from(t: LayerTable) -> Self {
        Self { weight: t.weight, bias: t.bias }
    }
}

/// The text of a network's file; `comment` lines go before it.
pub fn to_text(network: &Network, comment: &str) -> String {
    let mut out: String = comment.lines().map(|line| format!("# {line}\n")).collect();
    out += &format!("format = \"{FORMAT}\"\n");
    let known: Vec<_> = inputs().collect();
    for (index, s) in network.inputs.iter().zip(network.mlp.inputs()) {
        let Some(of) = known.get(*index) else { continue };
        let Scaling { offset, scale, low, high, margin } = s;
        out += &format!(
            "\n[[input]]\nname = \"{}\"\nunit = \"{}\"\noffset = {offset:?}\nscale = {scale:?}\nlow = {low:?}\n\
             high = {high:?}\nmargin = {margin:?}\n",
            of.name, of.unit
        );
    }
    for layer in network.mlp.hidden() {
        out += &format!("\n[[hidden]]\n{}", layer_text(layer));
    }
    let on: Vec<&str> = network.acts_on.iter().filter_map(|i| ACTS_ON.get(*i).copied()).collect();
    out += &format!("\n[output]\nacts_on = {on:?}\n{}", layer_text(network.mlp.output()));
    out
}

fn layer_text(layer: &Layer) -> String {
    let rows: String = layer.weight.iter().map(|row| format!("    {row:?},\n")).collect();
    format!("weight = [\n{rows}]\nbias = {:?}\n", layer.bias)
}

/// The network of a file's content; `file` names it in messages, `name` is that of the effect.
///
/// # Errors
/// [`VehicleError`] where the text is no network, names unknown inputs or outputs, has shapes that do not fit, numbers that are not
/// finite, or more than [`MAX_WEIGHTS`] weights.
pub fn parse(file: &str, name: &str, content: &str) -> Result<Network, VehicleError> {
    let wrong = |key: &str, expected: &str, found: String, remedy: &str| {
        Err(VehicleError::value(file, key, expected, found, remedy))
    };
    let read: NetworkFile = match toml::from_str(content) {
        Ok(read) => read,
        Err(e) => {
            let line = e.span().map_or(0, |s| content.get(..s.start).unwrap_or("").matches('\n').count());
            let found = format!("{} (line {})", e.message(), line + 1);
            let remedy = "correct it as docs/effects/network.md describes, or fit the network again";
            return wrong("(whole file)", "a network", found, remedy);
        }
    };
    if read.format != FORMAT {
        let remedy = "use the version of propwash that wrote it, or fit the network again";
        return wrong("format", FORMAT, read.format, remedy);
    }
    let known: Vec<_> = inputs().collect();
    let (mut places, mut scalings) = (Vec::new(), Vec::new());
    for (i, t) in read.input.iter().enumerate() {
        let Some(at) = known.iter().position(|v| v.name == t.name) else {
            let names: Vec<&str> = known.iter().map(|v| v.name).collect();
            let expected = format!("one of {}", names.join(", "));
            return wrong(&format!("input.{i}.name"), &expected, t.name.clone(), "correct the name");
        };
        if places.contains(&at) {
            let found = format!("{} a second time", t.name);
            return wrong(&format!("input.{i}.name"), "each input once", found, "remove one of them");
        }
        if known[at].unit != t.unit {
            let remedy = "convert offset, scale, low, high and margin to this unit";
            return wrong(&format!("input.{i}.unit"), known[at].unit, t.unit.clone(), remedy);
        }
        places.push(at);
        let InputTable { offset, scale, low, high, margin, .. } = *t;
        scalings.push(Scaling { offset, scale, low, high, margin });
    }
    let mut acts_on = Vec::new();
    for (i, on) in read.output.acts_on.iter().enumerate() {
        let at = ACTS_ON.iter().position(|known| known == on);
        let Some(at) = at.filter(|at| !acts_on.contains(at)) else {
            let expected = format!("each of {} at most once", ACTS_ON.join(", "));
            return wrong(&format!("output.acts_on.{i}"), &expected, on.clone(), "correct the name");
        };
        acts_on.push(at);
    }
    let hidden = read.hidden.into_iter().map(Layer::from).collect();
    let output = Layer { weight: read.output.weight, bias: read.output.bias };
    if output.bias.len() != acts_on.len() {
        let expected = format!("{} numbers, one for each entry of acts_on", acts_on.len());
        let found = output.bias.len().to_string();
        return wrong("output.bias", &expected, found, "write as many outputs as there are axes");
    }
    match Mlp::new(scalings, hidden, output) {
        Ok(mlp) => Ok(Network { name: name.into(), inputs: places, acts_on, mlp }),
        Err(e) => {
            let remedy = format!("correct the file, or fit a network of at most {MAX_WEIGHTS} weights again");
            wrong(&e.place, &e.expected, e.found, &remedy)
        }
    }
}

/// Reads the content of every network that the entries of a vehicle file name: beside the file where its folder is known, else by
/// their hash from what was read before. `label` names the vehicle file in messages.
pub(super) fn resolve(label: &str, dir: Option<&Path>, file: &mut VehicleFile) -> Result<(), VehicleError> {
    for (i, entry) in file.effect.iter_mut().enumerate().filter(|(_, e)| e.kind == KIND) {
        let check = Check::of(label);
        let key = format!("effect.{i}");
        let name = check.plain_file(&key, entry)?;
        let hash = check.hash(&key, entry)?;
        let content = match entry.params.get("content") {
            Some(toml::Value::String(content)) => content.clone(),
            Some(other) => {
                let found = format!("a {}", other.type_str());
                let place = format!("{key}.content");
                return Err(check.wrong(place, "the text of the network's file", found, "write it in quotes"));
            }
            None => match dir {
                Some(dir) => super::read_text(&dir.join(&name)).map_err(|error| {
                    let expected = format!("the network {name} beside the vehicle file");
                    let remedy = "put the file there: it was written together with the vehicle file";
                    check.wrong(format!("{key}.file"), &expected, error, remedy)
                })?,
                None => kept(&hash).ok_or_else(|| {
                    check.wrong(
                        format!("{key}.file"),
                        &format!("the network {name} of sha256 {hash:.12}…"),
                        "a text without a folder, beside which no file can be read",
                        "load the vehicle by the path of its file, with the network beside it, or add the text of the network \
                         as `content`",
                    )
                })?,
            },
        };
        let found = sha256_of(&content);
        if found != hash {
            return Err(check.wrong(
                format!("{key}.sha256"),
                &format!("that of {name}, {found}"),
                hash,
                "the network was changed: bring back the file that the vehicle was fitted with, or write the new hash",
            ));
        }
        keep(&content);
        entry.params.insert("content".into(), toml::Value::String(content));
    }
    Ok(())
}

impl Check<'_> {
    /// The name of a network's file: it lies beside the vehicle file.
    fn plain_file(&self, key: &str, entry: &EffectEntry) -> Result<String, VehicleError> {
        let place = format!("{key}.file");
        let remedy = "write e.g. file = \"bumps.network.toml\" and put that file beside the vehicle file";
        let Some(given) = entry.params.get("file") else {
            return Err(self.wrong(place, "the name of the network's file", "nothing", remedy));
        };
        let plain = |name: &&str| {
            !name.is_empty() && !name.starts_with('.') && !name.contains(['/', '\\', ':', '\0'])
        };
        match given.as_str().filter(plain) {
            Some(name) => Ok(name.into()),
            None => Err(self.wrong(place, "the name of a file without a folder", given, remedy)),
        }
    }

    fn hash(&self, key: &str, entry: &EffectEntry) -> Result<String, VehicleError> {
        let place = format!("{key}.sha256");
        let remedy = "write what `sha256sum` says of the network's file";
        let Some(given) = entry.params.get("sha256") else {
            return Err(self.wrong(place, "the SHA-256 of the network's file", "nothing", remedy));
        };
        let hex = |text: &&str| text.len() == 64 && text.bytes().all(|b| b.is_ascii_hexdigit());
        match given.as_str().filter(hex) {
            Some(hash) => Ok(hash.to_ascii_lowercase()),
            None => Err(self.wrong(place, "64 hexadecimal digits", given, remedy)),
        }
    }

    /// The effect of an entry of kind `network`, whose content was read.
    pub(super) fn network(&self, key: &str, entry: &EffectEntry) -> Result<AnyEffect<f64>, VehicleError> {
        const KEYS: [&str; 5] = ["name", "file", "sha256", "gain", "content"];
        if let Some(param) = entry.params.keys().find(|k| !KEYS.contains(&k.as_str())) {
            let expected = format!(
                "one of kind, models, source, source_log_sha256, date, note, sigma, {}",
                KEYS.join(", ")
            );
            let place = format!("{key}.{param}");
            return Err(self.wrong(place, &expected, "an unknown key", "correct or remove the key"));
        }
        let place = format!("{key}.name");
        let remedy = "write e.g. name = \"bumps\": it is the effect's name in verdicts and parameters";
        let Some(name) = entry.params.get("name") else {
            return Err(self.wrong(place, "a name of the effect", "nothing", remedy));
        };
        let Some(name) = name.as_str().filter(|n| is_identifier(n) && !kinds().contains(n)) else {
            let expected = "a name of letters, digits and underscores that begins with a letter and is no kind of effect";
            return Err(self.wrong(place, expected, name, remedy));
        };
        let gain = match entry.params.get("gain") {
            None => 1.0,
            Some(toml::Value::Float(v)) => *v,
            Some(toml::Value::Integer(v)) => *v as f64,
            Some(other) => {
                let found = format!("a {}", other.type_str());
                return Err(self.wrong(format!("{key}.gain"), "a number", found, "write it without quotes"));
            }
        };
        let of = |key: &str| entry.params.get(key).and_then(toml::Value::as_str).unwrap_or_default();
        let network = parse(of("file"), name, of("content"))?;
        Ok(AnyEffect::Network(Params { gain, network: intern(network) }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Vehicle;

    const CONTENT: &str = "format = \"propwash network 1\"\n\n[[input]]\nname = \"vx_body\"\nunit = \"m/s\"\noffset = 0.1\n\
                           scale = 2.0\nlow = -3.0\nhigh = 3.0\nmargin = 0.5\n\n[[hidden]]\nweight = [\n    [1.0],\n    [-0.5],\n]\n\
                           bias = [0.0, 0.2]\n\n[output]\nacts_on = [\"force_body_x_n\"]\nweight = [\n    [0.1, -0.2],\n]\nbias = [0.01]\n";

    fn base() -> &'static str {
        Vehicle::builtin_file("cf2x_L250").unwrap()
    }

    fn entry(sha256: &str, more: &str) -> String {
        format!(
            "{}\n[[effect]]\nkind = \"network\"\nname = \"bumps\"\nfile = \"bumps.network.toml\"\nsha256 = \"{sha256}\"\n{more}\n",
            base()
        )
    }

    fn content_of(content: &str) -> String {
        entry(&sha256_of(content), &format!("content = '''\n{content}'''"))
    }

    #[test]
    fn a_network_is_read_beside_its_vehicle_file_and_its_text_stands_alone() {
        let folder = tempfile::tempdir().unwrap();
        let (file, beside) = (folder.path().join("v.toml"), folder.path().join("bumps.network.toml"));
        let content = CONTENT.replace("offset = 0.1", "offset = 0.25");
        let text = entry(&sha256_of(&content), "gain = 0.5");
        std::fs::write(&file, &text).unwrap();
        let missing = Vehicle::load(&file).unwrap_err().to_string();
        assert!(
            missing.contains("bumps.network.toml") && missing.contains("put the file there"),
            "{missing}"
        );
        // Its text alone names a network that nobody knows.
        let unknown = Vehicle::from_toml("v", &text).unwrap_err().to_string();
        assert!(
            unknown.contains("`effect.") && unknown.contains("load the vehicle by the path"),
            "{unknown}"
        );
        std::fs::write(&beside, &content).unwrap();
        let vehicle = Vehicle::load(&file).unwrap();
        let drone = vehicle.drone("first_principles").unwrap();
        let effect = drone.effects.last().unwrap();
        assert_eq!(effect.label(), "network.bumps");
        assert_eq!(crate::effects::named_parameters(effect), [("gain".to_string(), 0.5)]);
        // Now it is known, and what `to_toml` gives holds it.
        assert!(Vehicle::from_toml("v", &text).unwrap().drone("first_principles").unwrap() == drone);
        let again = Vehicle::from_toml("v", vehicle.to_toml()).unwrap();
        assert_eq!((again.to_toml(), again.sha256()), (vehicle.to_toml(), vehicle.sha256()));
        assert!(vehicle.to_toml().contains("offset = 0.25"));
        assert_eq!(files_of(&text), [("bumps.network.toml".to_string(), content.clone())]);
        assert!(files_of(vehicle.to_toml()).is_empty());
        // Changed, it is refused.
        std::fs::write(&beside, content.replace("0.25", "0.26")).unwrap();
        let changed = Vehicle::load(&file).unwrap_err().to_string();
        assert!(changed.contains("sha256") && changed.contains("was changed"), "{changed}");
    }

    #[test]
    fn a_network_is_written_as_it_is_read() {
        let network = parse("it", "bumps", CONTENT).unwrap();
        assert_eq!(to_text(&network, ""), CONTENT);
        assert_eq!(parse("it", "bumps", &to_text(&network, "two\nlines")).unwrap(), network);
        assert!(to_text(&network, "two\nlines").starts_with("# two\n# lines\nformat"));
    }

    #[test]
    fn what_is_no_network_is_refused_in_words() {
        let said = |from: &str, to: &str| {
            let content = CONTENT.replace(from, to);
            assert_ne!(content, CONTENT, "{from}");
            Vehicle::from_toml("v", &content_of(&content)).unwrap_err().to_string()
        };
        for (from, to, words) in [
            ("\"propwash network 1\"", "\"propwash network 9\"", "propwash network 1"),
            ("vx_body", "vx_boddy", "one of pi, t, x"),
            ("\"m/s\"", "\"km/h\"", "expected m/s, found km/h"),
            ("scale = 2.0", "scale = 0.0", "input.0.scale"),
            ("scale = 2.0", "scale = nan", "finite"),
            ("low = -3.0", "low = 3.5", "less than high"),
            ("margin = 0.5", "margin = 0.0", "input.0.margin"),
            ("margin = 0.5\n", "", "missing field"),
            ("margin = 0.5", "margins = 0.5", "unknown field"),
            ("[1.0],", "[1.0, 2.0],", "hidden.0.weight.0"),
            ("[-0.5],\n", "", "hidden.0.weight"),
            ("0.1, -0.2", "0.1, inf", "output.weight.0.1"),
            ("bias = [0.01]", "bias = [0.01, 0.0]", "output.bias"),
            ("force_body_x_n", "force_x", "force_body_x_n"),
        ] {
            let told = said(from, to);
            assert!(told.contains(words) && told.contains("bumps.network.toml"), "{to}: {told}");
        }
        let row = format!("[{}],", vec!["0.1"; 32].join(", "));
        let wide = |n: usize| vec![row.as_str(); n].join("\n");
        let bias = |n: usize| vec!["0.0"; n].join(", ");
        let large = CONTENT.replace("    [1.0],\n    [-0.5],\n", &vec!["[1.0],"; 32].join("\n")).replace(
            "bias = [0.0, 0.2]",
            &format!("bias = [{}]\n[[hidden]]\nweight = [{}]\nbias = [{}]", bias(32), wide(30), bias(30)),
        );
        let large = large.replace("[0.1, -0.2]", &format!("[{}]", vec!["0.1"; 30].join(", ")));
        let told = Vehicle::from_toml("v", &content_of(&large)).unwrap_err().to_string();
        assert!(told.contains("at most 1000 weights") && told.contains("found 1085"), "{told}");
    }

    #[test]
    fn an_entry_without_what_it_needs_is_refused_in_words() {
        keep(CONTENT);
        let good = entry(&sha256_of(CONTENT), "");
        assert!(Vehicle::from_toml("v", &good).is_ok());
        for (from, to, words) in [
            ("name = \"bumps\"\n", "", "a name of the effect"),
            ("name = \"bumps\"", "name = \"payload\"", "no kind of effect"),
            ("file = \"bumps.network.toml\"\n", "", "the name of the network's file"),
            ("\"bumps.network.toml\"", "\"../bumps.toml\"", "a file without a folder"),
            ("\"bumps.network.toml\"", "7", "a file without a folder"),
            ("sha256 = \"", "sha256 = \"zz", "64 hexadecimal digits"),
            ("sha256 = ", "sha255 = ", "the SHA-256 of the network's file"),
            ("file = ", "weights = 3\nfile = ", "an unknown key"),
            ("file = ", "gain = \"1\"\nfile = ", "a number"),
            ("file = ", "gain = inf\nfile = ", "a finite number"),
            ("file = ", "content = 3\nfile = ", "the text of the network's file"),
            ("file = ", "content = \"format\"\nfile = ", "was changed"),
        ] {
            let text = good.replace(from, to);
            let told = Vehicle::from_toml("v", &text).unwrap_err().to_string();
            assert!(told.contains(words), "{to}: {told}");
        }
        let twice = format!("{good}\n{}", &good[good.rfind("[[effect]]").unwrap()..]);
        let told = Vehicle::from_toml("v", &twice).unwrap_err().to_string();
        assert!(told.contains("network.bumps a second time"), "{told}");
    }
}
