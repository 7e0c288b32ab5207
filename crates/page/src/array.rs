//! Arrays in the data of a page: little-endian bytes as base64, which `Propwash.array` and `Propwash.unpack` read.

use std::io::Write as _;

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use serde::Serialize;

/// What stands for "no value" among 16-bit numbers with a scale.
const NOTHING: i16 = i16::MIN;
/// The largest 16-bit number in use, in both directions.
const MOST: f64 = 32_767.0;

/// An array in the data of a page.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Array {
    /// Kind of the numbers: `u8`, `u16`, `u32`, `f32`, `f64`, or `i16` for `offset + scale * n`.
    of: &'static str,
    /// The bytes as they are.
    #[serde(skip_serializing_if = "Option::is_none")]
    base64: Option<String>,
    /// The bytes by zlib.
    #[serde(skip_serializing_if = "Option::is_none")]
    zlib: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    scale: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    offset: Option<f64>,
}

impl Array {
    fn new(of: &'static str, bytes: &[u8]) -> Self {
        Self { of, base64: Some(BASE64_STANDARD.encode(bytes)), zlib: None, scale: None, offset: None }
    }

    /// Bytes, as `Uint8Array` in the page.
    pub fn u8(values: &[u8]) -> Self {
        Self::new("u8", values)
    }

    /// Whole numbers, as `Uint16Array`.
    pub fn u16(values: impl IntoIterator<Item = u16>) -> Self {
        Self::new("u16", &values.into_iter().flat_map(u16::to_le_bytes).collect::<Vec<_>>())
    }

    /// Whole numbers, as `Uint32Array`.
    pub fn u32(values: impl IntoIterator<Item = u32>) -> Self {
        Self::new("u32", &values.into_iter().flat_map(u32::to_le_bytes).collect::<Vec<_>>())
    }

    /// Single precision, as `Float32Array`.
    pub fn f32(values: impl IntoIterator<Item = f32>) -> Self {
        Self::new("f32", &values.into_iter().flat_map(f32::to_le_bytes).collect::<Vec<_>>())
    }

    /// Double precision, as `Float64Array`.
    pub fn f64(values: impl IntoIterator<Item = f64>) -> Self {
        Self::new("f64", &values.into_iter().flat_map(f64::to_le_bytes).collect::<Vec<_>>())
    }

    /// Numbers in 16 bits each between the least and the largest of them, exact to 1/131,068 of that range; as `Float32Array`, with NaN
    /// where a value is not finite.
    pub fn i16(values: &[f64]) -> Self {
        let finite = || values.iter().copied().filter(|v| v.is_finite());
        let (low, high) =
            (finite().fold(f64::INFINITY, f64::min), finite().fold(f64::NEG_INFINITY, f64::max));
        let (offset, half) =
            if low <= high { (0.5 * low + 0.5 * high, 0.5 * high - 0.5 * low) } else { (0.0, 0.0) };
        let scale = if half > 0.0 { half / MOST } else { 1.0 };
        let number = |v: &f64| if v.is_finite() { ((v - offset) / scale).round() as i16 } else { NOTHING };
        let bytes: Vec<u8> = values.iter().map(number).flat_map(i16::to_le_bytes).collect();
        Self { scale: Some(scale), offset: Some(offset), ..Self::new("i16", &bytes) }
    }

    /// The same, compressed by zlib; only `Propwash.unpack` reads it. Pays for what repeats, such as images.
    pub fn packed(mut self) -> Self {
        let Some(bytes) = self.base64.take().and_then(|b| BASE64_STANDARD.decode(b).ok()) else {
            return self;
        };
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
        // Writing into memory does not fail.
        let packed = encoder.write_all(&bytes).and_then(|()| encoder.finish());
        match packed {
            Ok(packed) => self.zlib = Some(BASE64_STANDARD.encode(packed)),
            Err(_) => self.base64 = Some(BASE64_STANDARD.encode(bytes)),
        }
        self
    }

    /// Bytes that it takes on the page, names left out.
    pub fn weight(&self) -> usize {
        self.base64.as_ref().or(self.zlib.as_ref()).map_or(0, String::len)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes(array: &Array) -> Vec<u8> {
        BASE64_STANDARD.decode(array.base64.as_ref().unwrap()).unwrap()
    }

    #[test]
    fn numbers_are_little_endian() {
        assert_eq!(bytes(&Array::u16([0x1234])), [0x34, 0x12]);
        assert_eq!(bytes(&Array::f32([1.0])), 1.0f32.to_le_bytes());
        assert_eq!(bytes(&Array::f64([-2.5])), (-2.5f64).to_le_bytes());
        assert_eq!(bytes(&Array::u32([7])), [7, 0, 0, 0]);
    }

    #[test]
    fn sixteen_bits_keep_a_part_of_the_range_and_gaps() {
        let values = [-3.0, 5.0, f64::NAN, 0.123, f64::INFINITY];
        let array = Array::i16(&values);
        let (scale, offset) = (array.scale.unwrap(), array.offset.unwrap());
        let held: Vec<i16> = bytes(&array).chunks(2).map(|b| i16::from_le_bytes([b[0], b[1]])).collect();
        for (v, n) in values.iter().zip(&held) {
            if v.is_finite() {
                assert!((offset + scale * f64::from(*n) - v).abs() <= 8.0 / 131_068.0 * 1.0001);
            } else {
                assert_eq!(*n, NOTHING);
            }
        }
        assert_eq!(bytes(&Array::i16(&[2.0, 2.0])), [0; 4]);
        assert_eq!(Array::i16(&[f64::NAN]).offset, Some(0.0));
    }

    #[test]
    fn what_repeats_gets_small() {
        let array = Array::u16(vec![7; 10_000]);
        let (before, packed) = (array.weight(), array.packed());
        assert!(packed.base64.is_none() && packed.weight() < before / 100);
    }
}
