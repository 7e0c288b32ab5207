//! Bytes of a message to numbers: CDR as ROS 2 writes it, and the plain layout of ROS 1.
//!
//! Sources: OMG DDS-XTypes 1.3, 7.4.1 (plain CDR version 1) and 7.6.2.1.2 (encapsulation header); <https://wiki.ros.org/ROS/Technical%20Overview>
//! (ROS 1: little endian, no padding).

use super::schema::{Dialect, Kind, Many, Message, Number};

/// First bytes of data that zstd has packed.
const ZSTD: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// A message that is being read, from its first field on.
pub(super) struct Bytes<'a> {
    bytes: &'a [u8],
    at: usize,
    big_endian: bool,
    /// Whether numbers stand at multiples of their size, counted from the first field.
    aligned: bool,
}

/// A message is shorter than its fields.
pub(super) fn too_short() -> String {
    "a message that ends before its last field".into()
}

impl<'a> Bytes<'a> {
    /// # Errors
    /// In words, where the message is of another encoding.
    pub fn new(message: &'a [u8], dialect: Dialect) -> Result<Self, String> {
        if dialect == Dialect::Ros1 {
            return Ok(Self { bytes: message, at: 0, big_endian: false, aligned: false });
        }
        // Two bytes say how the message is written, two more are free.
        let (Some(header), Some(bytes)) = (message.get(..4), message.get(4..)) else {
            return Err("a message of less than 4 bytes, which is no CDR".into());
        };
        match header {
            [0, kind @ (0 | 1), ..] => Ok(Self { bytes, at: 0, big_endian: *kind == 0, aligned: true }),
            _ if *header == ZSTD => {
                Err("messages that are packed one by one (compression_mode `message`)".into())
            }
            [a, b, ..] => {
                Err(format!("messages in the representation {a:02x} {b:02x}, not plain CDR (00 00, 00 01)"))
            }
            [] | [_] => Err(too_short()),
        }
    }

    /// Bytes behind what was read.
    pub fn left(&self) -> usize {
        self.bytes.len() - self.at
    }

    fn align(&mut self, size: usize) {
        if self.aligned {
            self.at = self.at.next_multiple_of(size);
        }
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], String> {
        self.align(N);
        let bytes = self.bytes.get(self.at..).and_then(<[u8]>::first_chunk).ok_or_else(too_short)?;
        self.at += N;
        let mut bytes: [u8; N] = *bytes;
        if self.big_endian {
            bytes.reverse();
        }
        Ok(bytes)
    }

    /// A number, whatever its type; of 64-bit integers 53 bits.
    pub fn number(&mut self, number: Number) -> Result<f64, String> {
        Ok(match number {
            Number::Bool => f64::from(u8::from(self.take::<1>()? != [0])),
            Number::I8 => f64::from(i8::from_le_bytes(self.take()?)),
            Number::U8 => f64::from(u8::from_le_bytes(self.take()?)),
            Number::I16 => f64::from(i16::from_le_bytes(self.take()?)),
            Number::U16 => f64::from(u16::from_le_bytes(self.take()?)),
            Number::I32 => f64::from(i32::from_le_bytes(self.take()?)),
            Number::U32 => f64::from(u32::from_le_bytes(self.take()?)),
            Number::I64 => i64::from_le_bytes(self.take()?) as f64,
            Number::U64 => u64::from_le_bytes(self.take()?) as f64,
            Number::F32 => f64::from(f32::from_le_bytes(self.take()?)),
            Number::F64 => f64::from_le_bytes(self.take()?),
        })
    }

    /// How many elements follow.
    pub fn length(&mut self) -> Result<usize, String> {
        usize::try_from(u32::from_le_bytes(self.take()?)).map_err(|_| too_short())
    }

    /// A text, without the zero at its end that CDR has.
    pub fn text(&mut self) -> Result<&'a [u8], String> {
        let n = self.length()?;
        let text = self.bytes.get(self.at..self.at.saturating_add(n)).ok_or_else(too_short)?;
        self.at += n;
        Ok(text.strip_suffix(&[0]).unwrap_or(text))
    }

    /// Refuses elements that the rest of the message has no room for, before any of them is read.
    pub fn room(&self, kind: &Kind, n: usize) -> Result<(), String> {
        let needed = kind.least().saturating_mul(n);
        if needed <= self.bytes.len().saturating_sub(self.at) { Ok(()) } else { Err(too_short()) }
    }

    /// Passes over elements.
    pub fn skip(&mut self, kind: &Kind, n: usize) -> Result<(), String> {
        self.room(kind, n)?;
        match kind {
            Kind::Number(number) => {
                if n > 0 {
                    self.align(number.size());
                    self.room(kind, n)?;
                    self.at += n * number.size();
                }
            }
            Kind::Text => {
                for _ in 0..n {
                    self.text()?;
                }
            }
            // What takes no byte is nothing; there may be any number of it.
            Kind::Message(message) if message.least == 0 => {}
            Kind::Message(message) => {
                for _ in 0..n {
                    self.skip_message(message)?;
                }
            }
        }
        Ok(())
    }

    fn skip_message(&mut self, message: &Message) -> Result<(), String> {
        for field in &message.fields {
            let n = match field.many {
                Many::One => 1,
                Many::Array(n) => n,
                Many::Sequence => self.length()?,
            };
            self.skip(&field.kind, n)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_stand_where_alignment_puts_them_in_both_orders_of_bytes() {
        // A byte, a text of one letter, a float64: 1 + 3 bytes of padding, 4 + 2 bytes, 6 bytes of padding, 8 bytes.
        for big in [false, true] {
            let turn = |mut b: Vec<u8>| {
                if big {
                    b.reverse();
                }
                b
            };
            let mut message = vec![0, u8::from(!big), 0, 0, 7, 9, 9, 9];
            message.extend(turn(2u32.to_le_bytes().to_vec()));
            message.extend(b"a\0");
            message.extend([9; 6]);
            message.extend(turn(1.5f64.to_le_bytes().to_vec()));
            let mut bytes = Bytes::new(&message, Dialect::Ros2).unwrap();
            assert_eq!(bytes.number(Number::U8), Ok(7.0));
            assert_eq!(bytes.text(), Ok(&b"a"[..]));
            assert_eq!((bytes.number(Number::F64), bytes.left()), (Ok(1.5), 0));
            assert_eq!(bytes.number(Number::U8), Err(too_short()));
        }
    }

    #[test]
    fn an_empty_sequence_is_followed_by_no_padding() {
        let mut message = vec![0, 1, 0, 0];
        message.extend(0u32.to_le_bytes());
        message.extend(5u32.to_le_bytes());
        let mut bytes = Bytes::new(&message, Dialect::Ros2).unwrap();
        let n = bytes.length().unwrap();
        bytes.skip(&Kind::Number(Number::F64), n).unwrap();
        assert_eq!(bytes.number(Number::U32), Ok(5.0));
    }

    #[test]
    fn other_representations_are_refused_by_name() {
        let said = |m: &[u8]| Bytes::new(m, Dialect::Ros2).err().unwrap();
        assert!(said(&[0, 1]).contains("less than 4 bytes"));
        assert!(said(&[0, 7, 0, 0, 1]).contains("00 07"));
        assert!(said(&[0x28, 0xb5, 0x2f, 0xfd, 1]).contains("packed one by one"));
    }
}
