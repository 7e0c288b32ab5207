//! The container: records of an MCAP file, of which whatever is whole is read.
//!
//! Source: <https://mcap.dev/spec>. Chunks are unpacked by the library of the format; the records around them are few, and are walked here so that a
//! file that ends anywhere, or is damaged in one chunk, gives all the rest.

use crate::files::parsed;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::HashMap;
use std::sync::Arc;

/// First bytes of a file.
pub(in super::super) const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// Largest chunk that is unpacked, bytes: 256 MiB. Recorders write chunks of some megabytes.
const LARGEST_CHUNK: usize = 1 << 28;

const FOOTER: u8 = 2;
const SCHEMA: u8 = 3;
const CHANNEL: u8 = 4;
const MESSAGE: u8 = 5;
const CHUNK: u8 = 6;
const DATA_END: u8 = 15;

/// Definition of messages.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Schema {
    pub name: String,
    pub encoding: String,
    pub text: Vec<u8>,
}

/// A topic as one publisher declared it.
#[derive(Clone, Debug)]
pub(super) struct Channel {
    pub topic: String,
    pub encoding: String,
    pub schema: Option<Arc<Schema>>,
}

/// What is not whole.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Damage {
    /// Byte at which the file ends or is no longer understood.
    pub cut_at: Option<usize>,
    /// Chunks that were left out: byte, and why.
    pub chunks: Vec<(usize, String)>,
    /// Records that are too short, and messages of topics that no record declares.
    pub orphans: usize,
}

/// Receives messages: topic, time at which it was recorded (ns), content.
pub(super) type Sink<'a> = dyn FnMut(&Channel, u64, &[u8]) + 'a;

/// Gives all messages of a file in its order to `sink`.
pub(super) fn read(bytes: &[u8], sink: &mut Sink) -> Damage {
    let mut walk =
        Walk { schemas: HashMap::new(), channels: HashMap::new(), damage: Damage::default(), sink };
    let mut at = MAGIC.len();
    loop {
        let Some((kind, body, end)) = record(bytes, at) else {
            walk.damage.cut_at = Some(at);
            // Of a chunk that was being written the first messages may be there.
            if bytes.get(at) == Some(&CHUNK) {
                let (records, _) = unpack(&bytes[at..]);
                walk.records(&records);
            }
            break;
        };
        match kind {
            DATA_END | FOOTER => break,
            CHUNK => match unpack(&bytes[at..end]) {
                (records, Ok(())) => walk.records(&records),
                (_, Err(why)) => walk.damage.chunks.push((at, why)),
            },
            _ => walk.record(kind, body),
        }
        at = end;
    }
    walk.damage
}

/// The record at a byte: its kind, its content, where it ends.
fn record(bytes: &[u8], at: usize) -> Option<(u8, &[u8], usize)> {
    let rest = bytes.get(at..)?;
    let kind = *rest.first().filter(|kind| **kind != 0)?;
    let length = u64::from_le_bytes(*rest.get(1..)?.first_chunk()?);
    let length = usize::try_from(length).ok()?;
    let body = rest.get(9..9usize.checked_add(length)?)?;
    Some((kind, body, at + 9 + length))
}

/// The records of a chunk as they stand in a file, and whether they are all of it and as they were written.
fn unpack(chunk: &[u8]) -> (Vec<u8>, Result<(), String>) {
    let mut out = Vec::new();
    let told = parsed(|| unpack_into(&mut out, chunk)).and_then(|unpacked| unpacked);
    (out, told)
}

fn unpack_into(out: &mut Vec<u8>, mut chunk: &[u8]) -> Result<(), String> {
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_validate_chunk_crcs(true)
        .with_record_length_limit(LARGEST_CHUNK);
    let mut reader = LinearReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event.map_err(|e| e.to_string())? {
            LinearReadEvent::ReadRequest(wanted) => {
                let n = wanted.min(chunk.len());
                let (now, later) = chunk.split_at(n);
                reader.insert(n).copy_from_slice(now);
                reader.notify_read(n);
                chunk = later;
            }
            LinearReadEvent::Record { data, opcode } => {
                if out.len() + data.len() > LARGEST_CHUNK {
                    return Err(format!("it holds more than {LARGEST_CHUNK} bytes"));
                }
                out.push(opcode);
                out.extend((data.len() as u64).to_le_bytes());
                out.extend(data);
            }
        }
    }
    Ok(())
}

/// What was declared so far.
struct Walk<'a, 'b> {
    schemas: HashMap<u16, Arc<Schema>>,
    channels: HashMap<u16, Channel>,
    damage: Damage,
    sink: &'a mut Sink<'b>,
}

impl Walk<'_, '_> {
    fn records(&mut self, bytes: &[u8]) {
        let mut at = 0;
        while let Some((kind, body, end)) = record(bytes, at) {
            self.record(kind, body);
            at = end;
        }
    }

    fn record(&mut self, kind: u8, body: &[u8]) {
        let mut body = Fields(body);
        let used = match kind {
            SCHEMA => self.schema(&mut body),
            CHANNEL => self.channel(&mut body),
            MESSAGE => self.message(&mut body),
            _ => Some(()),
        };
        self.damage.orphans += usize::from(used.is_none());
    }

    fn message(&mut self, body: &mut Fields) -> Option<()> {
        let (id, _sequence, log, _published) = (body.u16()?, body.take::<4>()?, body.u64()?, body.u64()?);
        let channel = self.channels.get(&id)?;
        (self.sink)(channel, log, body.0);
        Some(())
    }

    fn schema(&mut self, body: &mut Fields) -> Option<()> {
        let id = body.u16()?;
        let schema = Schema { name: body.text()?, encoding: body.text()?, text: body.bytes()?.to_vec() };
        self.schemas.insert(id, Arc::new(schema));
        Some(())
    }

    fn channel(&mut self, body: &mut Fields) -> Option<()> {
        let (id, schema) = (body.u16()?, body.u16()?);
        let (topic, encoding) = (body.text()?, body.text()?);
        let schema = self.schemas.get(&schema).cloned();
        self.channels.insert(id, Channel { topic, encoding, schema });
        Some(())
    }
}

/// Fields of a record that are still to be read.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (now, later) = self.0.split_first_chunk()?;
        self.0 = later;
        Some(*now)
    }

    fn u16(&mut self) -> Option<u16> {
        self.take().map(u16::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.take().map(u64::from_le_bytes)
    }

    fn bytes(&mut self) -> Option<&'a [u8]> {
        let n = usize::try_from(u32::from_le_bytes(self.take()?)).ok()?;
        let (now, later) = self.0.split_at_checked(n)?;
        self.0 = later;
        Some(now)
    }

    fn text(&mut self) -> Option<String> {
        Some(String::from_utf8_lossy(self.bytes()?).into_owned())
    }
}
