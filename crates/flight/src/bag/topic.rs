//! Messages of one topic as columns of numbers.
//!
//! The columns are the numbers of a message by the path of their fields, `pose.position.x`, `data[2]`. A sequence gives columns while it has as many
//! elements in every message; longer ones than [`LONGEST`], images and point clouds, are passed over unread.

use super::cdr::Bytes;
use super::schema::{Dialect, Kind, Many, Message, Number};
use std::sync::Arc;

/// Most elements of an array or a sequence that become columns.
pub(super) const LONGEST: usize = 64;
/// Most columns of a topic.
const MOST_COLUMNS: usize = 4096;
/// Texts that are kept: where the message stands, and of whom it tells.
const TEXTS: [&str; 2] = ["header.frame_id", "child_frame_id"];

/// A step of reading a message.
enum Step {
    /// The next column.
    Number(Number),
    /// A text; its place in [`Topic::texts`], if it is kept.
    Text(Option<usize>),
    Skip(Kind, usize),
    /// The next list.
    List(Kind),
}

/// A sequence outside all others.
struct List {
    path: String,
    kind: Kind,
    /// Lengths of it and of the sequences in its elements, in the first message.
    shape: Vec<usize>,
    columns: Vec<Vec<f64>>,
    state: State,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    /// No message yet.
    New,
    /// As long in every message.
    Kept,
    Varies,
    TooLong,
}

/// A text of the messages.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Text {
    pub first: Vec<u8>,
    /// Whether another message has another.
    pub varies: bool,
}

/// A topic and its messages so far.
pub(super) struct Topic {
    /// `/pose`.
    pub name: String,
    /// `geometry_msgs/PoseStamped`.
    pub kind: String,
    /// When each message was recorded, ns.
    pub log_ns: Vec<i64>,
    /// Paths of [`Topic::columns`].
    pub paths: Vec<String>,
    /// Shape (path, message).
    pub columns: Vec<Vec<f64>>,
    /// Those of [`TEXTS`], in that order.
    texts: [Text; TEXTS.len()],
    /// What was left out, by path, and why.
    pub left_out: Vec<(String, &'static str)>,
    /// Messages that could not be read, and what was wrong with the first.
    pub failed: Option<(usize, String)>,
    /// Most bytes that stood behind the last field of a message.
    pub behind: usize,
    steps: Vec<Step>,
    lists: Vec<List>,
    dialect: Dialect,
    /// Of the message that is being read.
    row: Vec<f64>,
    list_rows: Vec<Option<ListRow>>,
}

/// Numbers and lengths of a list in one message; too long a list has none.
type ListRow = (Vec<f64>, Vec<usize>);

impl Topic {
    /// A topic without messages.
    ///
    /// # Errors
    /// In words, where its messages have too many numbers.
    pub fn new(name: &str, kind: &str, message: &Arc<Message>, dialect: Dialect) -> Result<Self, String> {
        let mut topic = Self {
            name: name.to_string(),
            kind: kind.to_string(),
            log_ns: Vec::new(),
            paths: Vec::new(),
            columns: Vec::new(),
            texts: Default::default(),
            left_out: Vec::new(),
            failed: None,
            behind: 0,
            steps: Vec::new(),
            lists: Vec::new(),
            dialect,
            row: Vec::new(),
            list_rows: Vec::new(),
        };
        topic.plan(message, "")?;
        topic.columns = vec![Vec::new(); topic.paths.len()];
        Ok(topic)
    }

    /// Lists the steps of reading a message that stands at a path.
    fn plan(&mut self, message: &Message, path: &str) -> Result<(), String> {
        for field in &message.fields {
            let path = if path.is_empty() { field.name.clone() } else { format!("{path}.{}", field.name) };
            match field.many {
                Many::One => self.plan_one(&field.kind, path)?,
                Many::Array(n) if n > LONGEST => {
                    self.left_out.push((path, "more than 64 elements"));
                    self.steps.push(Step::Skip(field.kind.clone(), n));
                }
                Many::Array(n) => {
                    for i in 0..n {
                        self.plan_one(&field.kind, format!("{path}[{i}]"))?;
                    }
                }
                Many::Sequence => {
                    let kind = field.kind.clone();
                    self.steps.push(Step::List(kind.clone()));
                    let (shape, columns) = (Vec::new(), Vec::new());
                    self.lists.push(List { path, kind, shape, columns, state: State::New });
                }
            }
            if self.steps.len() > MOST_COLUMNS {
                return Err(format!("messages of more than {MOST_COLUMNS} fields"));
            }
        }
        Ok(())
    }

    fn plan_one(&mut self, kind: &Kind, path: String) -> Result<(), String> {
        match kind {
            Kind::Number(number) => {
                self.steps.push(Step::Number(*number));
                self.paths.push(path);
            }
            Kind::Text => self.steps.push(Step::Text(TEXTS.iter().position(|t| *t == path))),
            // Nothing is in it, however deep.
            Kind::Message(message) if message.least == 0 => {}
            Kind::Message(message) => return self.plan(message, &path),
        }
        Ok(())
    }

    /// Takes a message that was recorded at a time, ns. One that cannot be read is counted and adds nothing.
    pub fn push(&mut self, log_ns: i64, message: &[u8]) {
        if let Err(why) = self.take(message) {
            self.failed.get_or_insert((0, why)).0 += 1;
            return;
        }
        self.log_ns.push(log_ns);
        self.columns.iter_mut().zip(&self.row).for_each(|(column, number)| column.push(*number));
        for (list, row) in self.lists.iter_mut().zip(self.list_rows.drain(..)) {
            list.push(row);
        }
    }

    /// Numbers that are kept of a message.
    pub fn width(&self) -> usize {
        self.columns.len() + self.lists.iter().map(|l| l.columns.len()).sum::<usize>()
    }

    fn take(&mut self, message: &[u8]) -> Result<(), String> {
        let mut bytes = Bytes::new(message, self.dialect)?;
        self.row.clear();
        self.list_rows.clear();
        for step in &self.steps {
            match step {
                Step::Number(number) => self.row.push(bytes.number(*number)?),
                Step::Text(place) => {
                    let text = bytes.text()?;
                    if let Some(kept) = place.map(|place| &mut self.texts[place]) {
                        if self.log_ns.is_empty() {
                            kept.first = text.to_vec();
                        }
                        kept.varies |= kept.first != text;
                    }
                }
                Step::Skip(kind, n) => bytes.skip(kind, *n)?,
                Step::List(kind) => self.list_rows.push(list(&mut bytes, kind)?),
            }
        }
        self.behind = self.behind.max(bytes.left());
        Ok(())
    }

    /// Makes columns of the lists, and puts messages in the order in which they were recorded, which files need not keep.
    pub fn finish(&mut self) {
        for list in std::mem::take(&mut self.lists) {
            match list.state {
                State::Kept => {
                    list.paths(&mut self.paths);
                    self.columns.extend(list.columns);
                }
                State::Varies => self.left_out.push((list.path, "not as long in every message")),
                State::TooLong => self.left_out.push((list.path, "more than 64 elements")),
                State::New => {}
            }
        }
        if self.log_ns.windows(2).all(|w| w[0] <= w[1]) {
            return;
        }
        let mut order: Vec<usize> = (0..self.log_ns.len()).collect();
        order.sort_by_key(|i| self.log_ns[*i]);
        self.log_ns = order.iter().map(|i| self.log_ns[*i]).collect();
        for column in &mut self.columns {
            *column = order.iter().map(|i| column[*i]).collect();
        }
    }

    /// A column by its path.
    pub fn column(&self, path: &str) -> Option<&[f64]> {
        self.paths.iter().position(|p| p == path).map(|i| self.columns[i].as_slice())
    }

    /// Columns by their paths, where all are there.
    pub fn all<const N: usize>(&self, paths: [String; N]) -> Option<[&[f64]; N]> {
        let mut out: [&[f64]; N] = [&[]; N];
        for (column, path) in out.iter_mut().zip(&paths) {
            *column = self.column(path)?;
        }
        Some(out)
    }

    /// The frame in which its messages stand, as far as it is told and the same in all.
    pub fn frame(&self) -> Option<&str> {
        self.text(0)
    }

    /// Whose motion they tell.
    pub fn child_frame(&self) -> Option<&str> {
        self.text(1)
    }

    /// Whether messages tell of several frames or bodies.
    pub fn mixed(&self) -> Option<&'static str> {
        self.texts.iter().position(|t| t.varies).map(|i| TEXTS[i])
    }

    fn text(&self, place: usize) -> Option<&str> {
        let text = &self.texts[place];
        std::str::from_utf8(&text.first).ok().filter(|t| !t.is_empty() && !text.varies)
    }

    /// Times of measurement by the messages themselves, ns; none where a message has none.
    pub fn stamps_ns(&self) -> Option<Vec<i64>> {
        let whole = |seconds: &[f64], fractions: &[f64]| -> Vec<i64> {
            seconds.iter().zip(fractions).map(|(s, ns)| (*s as i64) * 1_000_000_000 + *ns as i64).collect()
        };
        let px4 = || {
            // PX4 counts µs; the time of the sample is there where it differs from that of the message.
            let of = |path| self.column(path).filter(|c| c.iter().all(|us| *us > 0.0));
            let us = of("timestamp_sample").or_else(|| of("timestamp"))?;
            Some(us.iter().map(|us| (*us as i64).saturating_mul(1000)).collect())
        };
        let stamps = match self.column("header.stamp.sec") {
            Some(s) => {
                let ns = self.column("header.stamp.nanosec").or_else(|| self.column("header.stamp.nsec"))?;
                whole(s, ns)
            }
            None if self.kind.starts_with("px4_msgs/") => px4()?,
            None => return None,
        };
        stamps.iter().all(|ns| *ns > 0).then_some(stamps)
    }
}

impl List {
    fn push(&mut self, row: Option<ListRow>) {
        let Some((numbers, shape)) = row else {
            self.state = State::TooLong;
            self.columns = Vec::new();
            return;
        };
        match self.state {
            State::New => {
                self.columns = numbers.into_iter().map(|n| vec![n]).collect();
                self.shape = shape;
                self.state = State::Kept;
            }
            State::Kept if shape == self.shape => {
                self.columns.iter_mut().zip(numbers).for_each(|(column, number)| column.push(number));
            }
            State::Kept => {
                self.state = State::Varies;
                self.columns = Vec::new();
            }
            State::Varies | State::TooLong => {}
        }
    }

    /// The paths of its columns.
    fn paths(&self, out: &mut Vec<String>) {
        let mut shape = self.shape.iter().copied();
        elements(&self.kind, &self.path, shape.next().unwrap_or(0), &mut shape, out);
    }
}

/// Paths of `n` elements and of what is in them.
fn elements(
    kind: &Kind,
    path: &str,
    n: usize,
    shape: &mut dyn Iterator<Item = usize>,
    out: &mut Vec<String>,
) {
    for i in 0..n {
        let path = format!("{path}[{i}]");
        match kind {
            Kind::Number(_) => out.push(path),
            Kind::Text => {}
            Kind::Message(message) => inside(message, &path, shape, out),
        }
    }
}

fn inside(message: &Message, path: &str, shape: &mut dyn Iterator<Item = usize>, out: &mut Vec<String>) {
    for field in &message.fields {
        let path = format!("{path}.{}", field.name);
        match (field.many, &field.kind) {
            (Many::One, Kind::Number(_)) => out.push(path),
            (Many::One, Kind::Text) => {}
            (Many::One, Kind::Message(message)) => inside(message, &path, shape, out),
            (Many::Array(n), kind) if n <= LONGEST => elements(kind, &path, n, shape, out),
            (Many::Array(_), _) => {}
            (Many::Sequence, kind) => elements(kind, &path, shape.next().unwrap_or(0), shape, out),
        }
    }
}

/// A sequence; none where it, or one in its elements, is too long for columns.
fn list(bytes: &mut Bytes, kind: &Kind) -> Result<Option<ListRow>, String> {
    let mut row: ListRow = Default::default();
    let fits = sequence(bytes, kind, &mut row)?;
    Ok(fits.then_some(row))
}

/// Reads a sequence into a row; false where it does not fit into one.
fn sequence(bytes: &mut Bytes, kind: &Kind, row: &mut ListRow) -> Result<bool, String> {
    let n = bytes.length()?;
    row.1.push(n);
    if n > LONGEST {
        bytes.skip(kind, n)?;
        return Ok(false);
    }
    several(bytes, kind, n, row)
}

fn several(bytes: &mut Bytes, kind: &Kind, n: usize, row: &mut ListRow) -> Result<bool, String> {
    bytes.room(kind, n)?;
    let mut fits = true;
    for _ in 0..n {
        match kind {
            Kind::Number(number) => row.0.push(bytes.number(*number)?),
            Kind::Text => {
                bytes.text()?;
            }
            Kind::Message(message) if message.least == 0 => {}
            Kind::Message(message) => fits &= element(bytes, message, row)?,
        }
        if row.0.len() > MOST_COLUMNS || row.1.len() > MOST_COLUMNS {
            // Whoever gets here goes on without columns, but has to come to the end of the sequence.
            *row = Default::default();
            fits = false;
        }
    }
    Ok(fits)
}

fn element(bytes: &mut Bytes, message: &Message, row: &mut ListRow) -> Result<bool, String> {
    let mut fits = true;
    for field in &message.fields {
        fits &= match field.many {
            Many::One => several(bytes, &field.kind, 1, row)?,
            Many::Array(n) if n > LONGEST => {
                bytes.skip(&field.kind, n)?;
                true
            }
            Many::Array(n) => several(bytes, &field.kind, n, row)?,
            Many::Sequence => sequence(bytes, &field.kind, row)?,
        };
    }
    Ok(fits)
}
