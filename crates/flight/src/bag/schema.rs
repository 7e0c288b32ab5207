//! Definitions of ROS messages, as a bag carries them: text of `.msg` files, one after the other, to the fields of a message.
//!
//! Sources: <https://mcap.dev/spec/registry> (`ros1msg`, `ros2msg`: the definitions that a message needs stand behind it, each after a line of `=` and
//! a line `MSG: package/Name`), <https://docs.ros.org/en/rolling/Concepts/Basic/About-Interfaces.html> and <https://wiki.ros.org/msg> (types).

use std::collections::HashMap;
use std::sync::Arc;

/// Deepest nesting of messages; those of ROS have four levels.
const DEEPEST: usize = 32;

/// Which ROS wrote the definition; the two differ in a few types.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Dialect {
    /// `ros1msg`.
    Ros1,
    /// `ros2msg`.
    Ros2,
}

/// Type of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Number {
    Bool,
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Number {
    /// Bytes that it takes, which are also what it is aligned to.
    pub fn size(self) -> usize {
        match self {
            Self::Bool | Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    fn named(name: &str, dialect: Dialect) -> Option<Self> {
        Some(match name {
            "bool" => Self::Bool,
            // An octet; ROS 1 has always had it as another name of int8.
            "byte" if dialect == Dialect::Ros1 => Self::I8,
            "byte" | "char" | "uint8" => Self::U8,
            "int8" => Self::I8,
            "int16" => Self::I16,
            "uint16" => Self::U16,
            "int32" => Self::I32,
            "uint32" => Self::U32,
            "int64" => Self::I64,
            "uint64" => Self::U64,
            "float32" => Self::F32,
            "float64" => Self::F64,
            _ => return None,
        })
    }
}

/// What one element of a field is.
#[derive(Clone, Debug)]
pub(super) enum Kind {
    Number(Number),
    Text,
    Message(Arc<Message>),
}

impl Kind {
    /// Least number of bytes of an element, without what alignment adds.
    pub fn least(&self) -> usize {
        match self {
            Self::Number(number) => number.size(),
            Self::Text => 4,
            Self::Message(message) => message.least,
        }
    }
}

/// How many elements a field has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Many {
    One,
    Array(usize),
    /// As many as the message says, whatever bound the definition gives.
    Sequence,
}

/// A field.
#[derive(Clone, Debug)]
pub(super) struct Field {
    pub name: String,
    pub kind: Kind,
    pub many: Many,
}

/// Fields of a message, in the order in which they are written.
#[derive(Clone, Debug)]
pub(super) struct Message {
    pub fields: Vec<Field>,
    /// Least number of bytes, without what alignment adds.
    pub least: usize,
}

impl Message {
    fn new(fields: Vec<Field>) -> Arc<Self> {
        let least = fields.iter().map(|f| match f.many {
            Many::One => f.kind.least(),
            Many::Array(n) => f.kind.least().saturating_mul(n),
            Many::Sequence => 4,
        });
        let least = least.fold(0, usize::saturating_add);
        Arc::new(Self { fields, least })
    }

    fn pair(names: [&str; 2], numbers: [Number; 2]) -> Arc<Self> {
        let field =
            |i: usize| Field { name: names[i].into(), kind: Kind::Number(numbers[i]), many: Many::One };
        Self::new(vec![field(0), field(1)])
    }
}

/// `geometry_msgs/msg/Pose` and `geometry_msgs/Pose` as `geometry_msgs/Pose`.
pub(super) fn short_name(name: &str) -> String {
    match (name.split('/').next(), name.rsplit_once('/')) {
        (Some(package), Some((_, last))) => format!("{package}/{last}"),
        _ => name.to_string(),
    }
}

/// The fields of the message `name` by its definition.
///
/// # Errors
/// What about the definition is not understood, in words.
pub(super) fn parse(name: &str, text: &str, dialect: Dialect) -> Result<Arc<Message>, String> {
    let name = short_name(name);
    let mut definitions: HashMap<String, Vec<&str>> = HashMap::new();
    let mut current = name.clone();
    let mut header = false;
    for line in text.lines() {
        let bare = line.trim();
        if bare.len() >= 3 && bare.bytes().all(|b| b == b'=') {
            header = true;
        } else if let (true, Some(of)) = (header, bare.strip_prefix("MSG:")) {
            current = short_name(of.trim());
            // A message without a field has no line.
            definitions.entry(current.clone()).or_default();
            header = false;
        } else {
            definitions.entry(current.clone()).or_default().push(bare);
        }
    }
    definitions.entry(name.clone()).or_default();
    let mut reader = Reader { definitions, dialect, done: HashMap::new(), open: Vec::new() };
    reader.message(&name)
}

/// Definitions on their way to messages.
struct Reader<'a> {
    definitions: HashMap<String, Vec<&'a str>>,
    dialect: Dialect,
    done: HashMap<String, Arc<Message>>,
    /// Names whose fields are being read, outermost first.
    open: Vec<String>,
}

impl Reader<'_> {
    fn message(&mut self, name: &str) -> Result<Arc<Message>, String> {
        if let Some(done) = self.done.get(name) {
            return Ok(done.clone());
        }
        let Some(lines) = self.definitions.get(name).cloned() else {
            return self.built_in(name).ok_or_else(|| format!("no definition of `{name}`"));
        };
        if self.open.len() >= DEEPEST || self.open.iter().any(|n| n == name) {
            return Err(format!("a definition of `{name}` that contains itself"));
        }
        self.open.push(name.to_string());
        let mut fields = Vec::new();
        for line in lines {
            if let Some(field) = self.field(line, name)? {
                fields.push(field);
            }
        }
        self.open.pop();
        if fields.is_empty() && self.dialect == Dialect::Ros2 {
            // IDL knows no empty structure; ROS 2 puts this byte into it (rosidl_adapter, resource/struct.idl.em).
            let name = "structure_needs_at_least_one_member".into();
            fields.push(Field { name, kind: Kind::Number(Number::U8), many: Many::One });
        }
        let message = Message::new(fields);
        self.done.insert(name.to_string(), message.clone());
        Ok(message)
    }

    /// Times, which definitions may leave out.
    fn built_in(&self, name: &str) -> Option<Arc<Message>> {
        matches!(name, "builtin_interfaces/Time" | "builtin_interfaces/Duration")
            .then(|| Message::pair(["sec", "nanosec"], [Number::I32, Number::U32]))
    }

    /// The field of a line; none on lines of comments and of constants.
    fn field(&mut self, line: &str, owner: &str) -> Result<Option<Field>, String> {
        let line = line.split('#').next().unwrap_or_default().trim();
        if line.is_empty() {
            return Ok(None);
        }
        let wrong = || format!("the line `{}`", line.chars().take(60).collect::<String>());
        let (kind, rest) = line.split_once(char::is_whitespace).ok_or_else(wrong)?;
        let rest = rest.trim_start();
        let end = rest.find(|c: char| !c.is_ascii_alphanumeric() && c != '_').unwrap_or(rest.len());
        let (name, behind) = rest.split_at(end);
        if name.is_empty() {
            return Err(wrong());
        }
        // `TYPE NAME=VALUE` is a constant, and anything else behind a name its value where nobody gave one: neither is written.
        if behind.trim_start().starts_with('=') {
            return Ok(None);
        }
        let (kind, many) = match kind.strip_suffix(']').and_then(|k| k.rsplit_once('[')) {
            None => (kind, Many::One),
            Some((kind, "")) => (kind, Many::Sequence),
            Some((kind, bound)) if bound.starts_with("<=") => (kind, Many::Sequence),
            Some((kind, n)) => (kind, Many::Array(n.parse().map_err(|_| wrong())?)),
        };
        let kind = self.kind(kind.split("<=").next().unwrap_or(kind), owner)?;
        Ok(Some(Field { name: name.to_string(), kind, many }))
    }

    fn kind(&mut self, name: &str, owner: &str) -> Result<Kind, String> {
        if let Some(number) = Number::named(name, self.dialect) {
            return Ok(Kind::Number(number));
        }
        Ok(match (name, self.dialect) {
            ("string", _) => Kind::Text,
            ("wstring", _) => return Err("a field of type `wstring`, which is not read".into()),
            ("time", Dialect::Ros1) => {
                Kind::Message(Message::pair(["sec", "nsec"], [Number::U32, Number::U32]))
            }
            ("duration", Dialect::Ros1) => {
                Kind::Message(Message::pair(["sec", "nsec"], [Number::I32, Number::I32]))
            }
            ("time" | "duration", Dialect::Ros2) => {
                Kind::Message(Message::pair(["sec", "nanosec"], [Number::I32, Number::U32]))
            }
            _ => Kind::Message(self.message(&self.full_name(name, owner))?),
        })
    }

    /// The name of a type as its owner means it.
    fn full_name(&self, name: &str, owner: &str) -> String {
        if name.contains('/') {
            return short_name(name);
        }
        if name == "Header" {
            return "std_msgs/Header".into();
        }
        let package = owner.split('/').next().unwrap_or_default();
        format!("{package}/{name}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(message: &Message) -> Vec<&str> {
        message.fields.iter().map(|f| f.name.as_str()).collect()
    }

    #[test]
    fn constants_comments_bounds_and_default_values_are_told_from_fields() {
        let text = "# a comment\nuint8 A=1\nstring WORD = \"a # b\" # constant\nstring<=10 name \"x#y\"\nfloat64[<=3] few # three\n\
                    int32[4] four [1, 2, 3, 4]\nstring<=5[] words\nbool on true\nInner in\nother/msg/Far far\n\
                    ===\nMSG: own/Inner\nchar c\nbyte b\n\
                    ================================================================================\nMSG: other/Far\nwrong/Never[] never\n\
                    ===\nMSG: wrong/Never\nfloat32 x\n";
        let message = parse("own/msg/Test", text, Dialect::Ros2).unwrap();
        assert_eq!(names(&message), ["name", "few", "four", "words", "on", "in", "far"]);
        let many: Vec<Many> = message.fields.iter().map(|f| f.many).collect();
        assert_eq!(many[..4], [Many::One, Many::Sequence, Many::Array(4), Many::Sequence]);
        assert!(matches!(message.fields[3].kind, Kind::Text));
        let Kind::Message(inner) = &message.fields[5].kind else { panic!() };
        assert_eq!(names(inner), ["c", "b"]);
        assert_eq!(message.least, 4 + 4 + 16 + 4 + 1 + 2 + 4);
    }

    #[test]
    fn times_and_empty_messages_are_as_each_ros_writes_them() {
        let one =
            parse("a/B", "Header header\ntime t\n===\nMSG: std_msgs/Header\nuint32 seq\n", Dialect::Ros1);
        let one = one.unwrap();
        let Kind::Message(time) = &one.fields[1].kind else { panic!() };
        assert_eq!(names(time), ["sec", "nsec"]);
        let two = parse("a/msg/B", "builtin_interfaces/Time stamp\n", Dialect::Ros2).unwrap();
        assert_eq!(two.least, 8);
        assert_eq!(parse("a/msg/B", "\n", Dialect::Ros2).unwrap().least, 1);
        assert_eq!(parse("a/B", "", Dialect::Ros1).unwrap().least, 0);
    }

    #[test]
    fn what_is_not_understood_is_said() {
        let said = |text: &str| parse("a/msg/B", text, Dialect::Ros2).unwrap_err();
        assert!(said("Nowhere n").contains("no definition of `a/Nowhere`"));
        assert!(said("B inner").contains("contains itself"));
        assert!(said("wstring w").contains("wstring"));
        assert!(said("float64").contains("the line `float64`"));
        assert!(said("float64[x] y").contains("float64[x] y"));
        let chain: String = (0..100).map(|i| format!("===\nMSG: a/N{i}\nN{} n\n", i + 1)).collect();
        assert!(said(&format!("N0 n\n{chain}")).contains("contains itself"));
    }
}
