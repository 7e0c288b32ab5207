//! A world of a data set as an MCAP file, which Foxglove and PlotJuggler open.
//!
//! Messages are JSON. Poses, images, cameras and contacts have the schemas of Foxglove (<https://docs.foxglove.dev/docs/sdk/schemas>), by whose
//! names its panels know them; all other numbers are flat objects, whose fields PlotJuggler lists. Times count from the start of the flight.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;

use ::mcap::records::MessageHeader;
use ::mcap::{Attachment, WriteOptions, Writer};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Map, Value, json};

use super::{DatasetError, Frames, Manifest, Table, WorldReader, status};
use crate::math::quat;

type Result<T> = std::result::Result<T, DatasetError>;

/// What a file holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct McapSummary {
    /// Messages in all.
    pub messages: u64,
    /// Topics.
    pub topics: usize,
    /// Depth images.
    pub images: u64,
}

/// Schemas by name, with the fields that readers ask for.
const SCHEMAS: [(&str, &str); 7] = [
    (
        "foxglove.FrameTransform",
        r#"{"timestamp":TIME,"parent_frame_id":TEXT,"child_frame_id":TEXT,"translation":VECTOR,"rotation":QUATERNION}"#,
    ),
    (
        "foxglove.PoseInFrame",
        r#"{"timestamp":TIME,"frame_id":TEXT,"pose":{"type":"object","properties":{"position":VECTOR,"orientation":QUATERNION}}}"#,
    ),
    (
        "foxglove.RawImage",
        r#"{"timestamp":TIME,"frame_id":TEXT,"width":WHOLE,"height":WHOLE,"encoding":TEXT,"step":WHOLE,"data":{"type":"string","contentEncoding":"base64"}}"#,
    ),
    (
        "foxglove.CameraCalibration",
        r#"{"timestamp":TIME,"frame_id":TEXT,"width":WHOLE,"height":WHOLE,"distortion_model":TEXT,"D":NUMBERS,"K":NUMBERS,"R":NUMBERS,"P":NUMBERS}"#,
    ),
    ("foxglove.SceneUpdate", r#"{"deletions":{"type":"array"},"entities":{"type":"array"}}"#),
    ("propwash.State", "{}"),
    ("propwash.Clearance", "{}"),
];

/// The JSON schema of a name.
fn schema(name: &str, properties: &str) -> String {
    let time = r#"{"type":"object","title":"time","properties":{"sec":{"type":"integer"},"nsec":{"type":"integer"}}}"#;
    let number = r#"{"type":"number"}"#;
    let of = |names: &str| {
        let each: Vec<String> = names.chars().map(|c| format!("\"{c}\":{number}")).collect();
        format!("{{\"type\":\"object\",\"properties\":{{{}}}}}", each.join(","))
    };
    let properties = properties
        .replace("TIME", time)
        .replace("TEXT", r#"{"type":"string"}"#)
        .replace("WHOLE", r#"{"type":"integer"}"#)
        .replace("NUMBERS", r#"{"type":"array","items":{"type":"number"}}"#)
        .replace("VECTOR", &of("xyz"))
        .replace("QUATERNION", &of("xyzw"));
    format!(r#"{{"title":"{name}","type":"object","properties":{properties}}}"#)
}

/// A file that grows: channels by topic, and the number of the next message of each.
struct Out<'a> {
    writer: Writer<BufWriter<&'a mut File>>,
    schemas: BTreeMap<&'static str, u16>,
    channels: BTreeMap<String, (u16, u32)>,
    summary: McapSummary,
}

fn fault(e: impl std::fmt::Display) -> DatasetError {
    DatasetError::Export { what: format!("MCAP: {e}") }
}

impl Out<'_> {
    fn put(&mut self, t_s: f64, topic: &str, schema: &'static str, message: &Value) -> Result<()> {
        if !self.channels.contains_key(topic) {
            let schema = self.schemas.get(schema).copied().unwrap_or(0);
            let id = self.writer.add_channel(schema, topic, "json", &BTreeMap::new()).map_err(fault)?;
            self.channels.insert(topic.to_string(), (id, 0));
        }
        let Some((channel_id, next)) = self.channels.get_mut(topic) else { return Ok(()) };
        let (channel_id, sequence) = (*channel_id, *next);
        *next = sequence.wrapping_add(1);
        let time = nanoseconds(t_s);
        let header = MessageHeader { channel_id, sequence, log_time: time, publish_time: time };
        self.summary.messages += 1;
        self.writer.write_to_known_channel(&header, message.to_string().as_bytes()).map_err(fault)
    }
}

fn nanoseconds(t_s: f64) -> u64 {
    (t_s * 1e9).round().max(0.0) as u64
}

fn stamp(t_s: f64) -> Value {
    let ns = nanoseconds(t_s);
    json!({ "sec": ns / 1_000_000_000, "nsec": ns % 1_000_000_000 })
}

fn vector(v: [f64; 3]) -> Value {
    json!({ "x": v[0], "y": v[1], "z": v[2] })
}

fn quaternion(q: [f64; 4]) -> Value {
    json!({ "x": q[0], "y": q[1], "z": q[2], "w": q[3] })
}

fn transform(t_s: f64, parent: &str, child: &str, pos: [f64; 3], quat: [f64; 4]) -> Value {
    json!({
        "timestamp": stamp(t_s), "parent_frame_id": parent, "child_frame_id": child,
        "translation": vector(pos), "rotation": quaternion(quat),
    })
}

/// Where a moment's messages come from, in the order in which they are written.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    State,
    Frame,
    Contact,
    Clearance,
}

/// Writes one world. Depth images have metres as 32-bit floats, NaN where nothing in range was met (as ROS has them); cameras look along
/// z, with x right and y down, as Foxglove has them.
///
/// # Errors
/// [`DatasetError`] for a world that is damaged, and where the file cannot be written.
pub fn write(world: &WorldReader, to: &mut File) -> Result<McapSummary> {
    let manifest = world.manifest();
    let (states, contacts) = (world.states(None)?, world.contacts(None)?);
    let clearance = match manifest.flight.clearance_every_steps {
        0 => None,
        _ => Some(world.clearance(None)?),
    };
    let frames = if manifest.cameras.is_empty() { None } else { Some(world.frames()?) };
    let mut moments: Vec<(f64, Kind, usize)> = Vec::new();
    let mut add = |kind, times: &[f64]| moments.extend(times.iter().enumerate().map(|(i, t)| (*t, kind, i)));
    add(Kind::State, states.column("t")?);
    add(Kind::Contact, contacts.column("t")?);
    if let Some(table) = &clearance {
        add(Kind::Clearance, table.column("t")?);
    }
    if let Some(frames) = &frames {
        add(Kind::Frame, frames.time_s.as_slice().unwrap_or_default());
    }
    moments.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));

    let options = WriteOptions::new().compression(None).profile("").library("propwash");
    let writer = options.create(BufWriter::new(to)).map_err(fault)?;
    let mut out =
        Out { writer, schemas: BTreeMap::new(), channels: BTreeMap::new(), summary: McapSummary::default() };
    for (name, properties) in SCHEMAS {
        let text = schema(name, properties);
        let id = out.writer.add_schema(name, "jsonschema", text.as_bytes()).map_err(fault)?;
        out.schemas.insert(name, id);
    }
    let text = serde_json::to_vec_pretty(manifest).map_err(fault)?;
    let attachment = Attachment {
        log_time: 0,
        create_time: 0,
        name: "manifest.json".into(),
        media_type: "application/json".into(),
        data: Cow::Owned(text),
    };
    out.writer.attach(&attachment).map_err(fault)?;
    let columns = StateColumns::new(&states)?;
    for (t, kind, row) in moments {
        match kind {
            Kind::State => state(&mut out, &columns, t, row)?,
            Kind::Contact => contact(&mut out, &contacts, manifest, t, row)?,
            Kind::Clearance => near(&mut out, clearance.as_ref(), t, row)?,
            Kind::Frame => {
                if let Some(frames) = &frames {
                    frame(&mut out, frames, manifest, t, row)?;
                }
            }
        }
    }
    out.writer.finish().map_err(fault)?;
    out.summary.topics = out.channels.len();
    Ok(out.summary)
}

/// Columns of the states, looked up once.
struct StateColumns<'a> {
    drone: &'a [f64],
    pos: [&'a [f64]; 3],
    quat: [&'a [f64]; 4],
    others: Vec<(&'a str, &'a [f64])>,
}

impl<'a> StateColumns<'a> {
    fn new(table: &'a Table) -> Result<Self> {
        let of = |name: &str| table.column(name);
        let placed = ["t", "step", "world", "drone", "px", "py", "pz", "qx", "qy", "qz", "qw"];
        let others = table.names().filter(|n| !placed.contains(n));
        Ok(Self {
            drone: of("drone")?,
            pos: [of("px")?, of("py")?, of("pz")?],
            quat: [of("qx")?, of("qy")?, of("qz")?, of("qw")?],
            others: others.map(|n| Ok((n, table.column(n)?))).collect::<Result<_>>()?,
        })
    }
}

fn state(out: &mut Out, of: &StateColumns, t: f64, row: usize) -> Result<()> {
    let drone = of.drone[row];
    let (pos, quat) = (of.pos.map(|c| c[row]), of.quat.map(|c| c[row]));
    let name = format!("drone{drone}");
    out.put(t, "/tf", "foxglove.FrameTransform", &transform(t, "world", &name, pos, quat))?;
    let pose = json!({
        "timestamp": stamp(t), "frame_id": "world",
        "pose": { "position": vector(pos), "orientation": quaternion(quat) },
    });
    out.put(t, &format!("/{name}/pose"), "foxglove.PoseInFrame", &pose)?;
    // Empty cells have no field.
    let numbers = of.others.iter().filter(|(_, column)| column[row].is_finite());
    let numbers: Map<String, Value> =
        numbers.map(|(n, column)| (n.to_string(), json!(column[row]))).collect();
    out.put(t, &format!("/{name}/state"), "propwash.State", &Value::Object(numbers))
}

fn contact(out: &mut Out, table: &Table, manifest: &Manifest, t: f64, row: usize) -> Result<()> {
    let of = |name: &str| table.column(name).map(|c| c[row]);
    let at = [of("x")?, of("y")?, of("z")?];
    let normal = [of("nx")?, of("ny")?, of("nz")?];
    let drone = of("drone")?;
    let touched = of("geom2")?;
    let geom = manifest.geoms.iter().find(|g| f64::from(g.id) == touched);
    let pose = json!({ "position": vector(at), "orientation": quaternion(along(normal)) });
    let entity = json!({
        "timestamp": stamp(t), "frame_id": "world", "id": format!("{row}"), "frame_locked": false,
        "lifetime": { "sec": 0, "nsec": 200_000_000 },
        "metadata": [{ "key": "geom", "value": geom.map_or("", |g| g.name.as_str()) },
                     { "key": "distance_m", "value": of("distance")?.to_string() }],
        "spheres": [{ "pose": pose, "size": vector([0.02; 3]), "color": { "r": 0.9, "g": 0.1, "b": 0.1, "a": 1.0 } }],
        "cubes": [], "cylinders": [], "lines": [], "triangles": [], "texts": [], "models": [],
        "arrows": [{ "pose": pose, "shaft_length": 0.1, "shaft_diameter": 0.008, "head_length": 0.03,
                     "head_diameter": 0.02, "color": { "r": 0.9, "g": 0.1, "b": 0.1, "a": 1.0 } }],
    });
    let message = json!({ "deletions": [], "entities": [entity] });
    out.put(t, &format!("/drone{drone}/contacts"), "foxglove.SceneUpdate", &message)
}

/// The shortest turn from the x axis, along which arrows lie, to a direction of length one.
fn along(direction: [f64; 3]) -> [f64; 4] {
    let [x, y, z] = direction;
    match x < -0.999_999 {
        true => [0.0, 0.0, 1.0, 0.0],
        false => quat::normalize([0.0, -z, y, 1.0 + x]),
    }
}

fn near(out: &mut Out, table: Option<&Table>, t: f64, row: usize) -> Result<()> {
    let Some(table) = table else { return Ok(()) };
    let drone = table.column("drone")?[row];
    let mut numbers = Map::new();
    for name in table.names().filter(|n| !["t", "step", "world", "drone"].contains(n)) {
        let value = table.column(name)?[row];
        if value.is_finite() {
            numbers.insert(name.to_string(), json!(value));
        }
    }
    out.put(t, &format!("/drone{drone}/clearance"), "propwash.Clearance", &Value::Object(numbers))
}

fn frame(out: &mut Out, frames: &Frames, manifest: &Manifest, t: f64, f: usize) -> Result<()> {
    for (o, name) in manifest.obstacles.iter().enumerate() {
        if let (Some(pos), Some(quat)) = (&frames.obstacle_pos_m, &frames.obstacle_quat_xyzw) {
            let (p, q) = ([0, 1, 2].map(|k| pos[[f, o, k]]), [0, 1, 2, 3].map(|k| quat[[f, o, k]]));
            out.put(t, "/tf", "foxglove.FrameTransform", &transform(t, "world", name, p, q))?;
        }
    }
    for (d, camera) in manifest.cameras.iter().enumerate() {
        let own = format!("drone{d}/");
        // Cameras of shells have it in their names.
        let id = if camera.name.starts_with(&own) { camera.name.clone() } else { own + &camera.name };
        let pos = [0, 1, 2].map(|k| frames.camera_pos_m[[f, d, k]]);
        let quat = [0, 1, 2, 3].map(|k| frames.camera_quat_xyzw[[f, d, k]]);
        // Ours look against z with y up, those of Foxglove along z with y down: half a turn about x.
        let seen = quat::mul(quat, [1.0, 0.0, 0.0, 0.0]);
        out.put(t, "/tf", "foxglove.FrameTransform", &transform(t, "world", &id, pos, seen))?;
        let (width, height) = (camera.width, camera.height);
        let k: Vec<f64> = camera.k.concat();
        let p: Vec<f64> = camera.k.iter().flat_map(|row| [row[0], row[1], row[2], 0.0]).collect();
        let calibration = json!({
            "timestamp": stamp(t), "frame_id": id, "width": width, "height": height, "distortion_model": "",
            "D": [], "K": k, "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], "P": p,
        });
        out.put(t, &format!("/drone{d}/camera_info"), "foxglove.CameraCalibration", &calibration)?;
        let mut bytes = Vec::with_capacity(4 * width * height);
        for row in 0..height {
            for column in 0..width {
                let hit = frames.status[[f, d, row, column]] == status::HIT;
                let depth = if hit { frames.depth_m[[f, d, row, column]] } else { f32::NAN };
                bytes.extend(depth.to_le_bytes());
            }
        }
        let image = json!({
            "timestamp": stamp(t), "frame_id": id, "width": width, "height": height, "encoding": "32FC1",
            "step": 4 * width, "data": STANDARD.encode(bytes),
        });
        out.put(t, &format!("/drone{d}/depth"), "foxglove.RawImage", &image)?;
        out.summary.images += 1;
    }
    Ok(())
}
