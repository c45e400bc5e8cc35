//! Plain CDR (OMG XCDR1), as ROS 2 serialises messages: a 4-byte encapsulation header that says
//! the byte order, then fields aligned to their size, counted from behind the header.
//!
//! The reader does no I/O, borrows from the buffer, never panics, and allocates only what the
//! bytes left can fill. An empty sequence is its length alone: no padding before elements that
//! are not there.

use super::error::WireError;

const HEADER_BYTES: usize = 4;

/// A number as it lies in a message.
pub trait Scalar: Copy {
    /// Its size, and so its alignment.
    const NUM_BYTES: usize;
    /// From exactly [`Self::NUM_BYTES`] little-endian bytes.
    fn from_le(bytes: &[u8]) -> Self;
    /// From exactly [`Self::NUM_BYTES`] big-endian bytes.
    fn from_be(bytes: &[u8]) -> Self;
    /// Appends its bytes.
    fn append(self, big_endian: bool, bytes: &mut Vec<u8>);
}

macro_rules! scalar {
    ($($number:ty),*) => {$(
        impl Scalar for $number {
            const NUM_BYTES: usize = size_of::<$number>();
            #[inline]
            fn from_le(bytes: &[u8]) -> Self {
                bytes.first_chunk().map_or(Self::default(), |b| Self::from_le_bytes(*b))
            }
            #[inline]
            fn from_be(bytes: &[u8]) -> Self {
                bytes.first_chunk().map_or(Self::default(), |b| Self::from_be_bytes(*b))
            }
            #[inline]
            fn append(self, big_endian: bool, bytes: &mut Vec<u8>) {
                if big_endian {
                    bytes.extend_from_slice(&self.to_be_bytes());
                } else {
                    bytes.extend_from_slice(&self.to_le_bytes());
                }
            }
        }
    )*};
}
scalar!(u8, i8, u16, i32, u32, i64, u64, f32, f64);

/// Reads fields in order.
#[derive(Clone, Debug)]
pub struct CdrReader<'a> {
    message: &'static str,
    body: &'a [u8],
    offset: usize,
    big_endian: bool,
}

impl<'a> CdrReader<'a> {
    /// A reader of the serialised `message` (its type's name, for errors).
    ///
    /// # Errors
    /// [`WireError::Encapsulation`] unless the bytes start with the header of plain CDR.
    pub fn new(message: &'static str, bytes: &'a [u8]) -> Result<Self, WireError> {
        let big_endian = match bytes {
            [0, 0, _, _, ..] => true,
            [0, 1, _, _, ..] => false,
            _ => {
                let header = bytes.iter().copied().take(HEADER_BYTES).collect();
                return Err(WireError::Encapsulation { message, header });
            }
        };
        Ok(Self {
            message,
            body: &bytes[HEADER_BYTES..],
            offset: 0,
            big_endian,
        })
    }

    fn truncated(
        &self,
        field: &'static str,
        num_elements: usize,
        element_bytes: usize,
    ) -> WireError {
        WireError::Truncated {
            message: self.message,
            field,
            offset: self.offset + HEADER_BYTES,
            num_elements,
            element_bytes,
            available: self.body.len().saturating_sub(self.offset),
        }
    }

    /// `num_elements` × `element_bytes`, the first aligned to `align`; nothing for no elements.
    fn take(
        &mut self,
        field: &'static str,
        align: usize,
        num_elements: usize,
        element_bytes: usize,
    ) -> Result<&'a [u8], WireError> {
        if num_elements == 0 {
            return Ok(&[]);
        }
        let start = self.offset.next_multiple_of(align);
        let taken = num_elements
            .checked_mul(element_bytes)
            .and_then(|num_bytes| start.checked_add(num_bytes))
            .and_then(|end| self.body.get(start..end));
        let bytes = taken.ok_or_else(|| self.truncated(field, num_elements, element_bytes))?;
        self.offset = start + bytes.len();
        Ok(bytes)
    }

    /// One number.
    ///
    /// # Errors
    /// [`WireError::Truncated`] when it is not there.
    #[inline]
    pub fn scalar<T: Scalar>(&mut self, field: &'static str) -> Result<T, WireError> {
        let bytes = self.take(field, T::NUM_BYTES, 1, T::NUM_BYTES)?;
        Ok(if self.big_endian {
            T::from_be(bytes)
        } else {
            T::from_le(bytes)
        })
    }

    /// A `bool`: any byte but 0 is true, as C++ readers have it.
    ///
    /// # Errors
    /// [`WireError::Truncated`] when it is not there.
    pub fn bool(&mut self, field: &'static str) -> Result<bool, WireError> {
        Ok(self.scalar::<u8>(field)? != 0)
    }

    /// A fixed array of numbers.
    ///
    /// # Errors
    /// [`WireError::Truncated`] when it is not there.
    pub fn array<T: Scalar, const N: usize>(
        &mut self,
        field: &'static str,
    ) -> Result<[T; N], WireError> {
        let bytes = self.take(field, T::NUM_BYTES, N, T::NUM_BYTES)?;
        let at = |i: usize| &bytes[i * T::NUM_BYTES..][..T::NUM_BYTES];
        Ok(if self.big_endian {
            std::array::from_fn(|i| T::from_be(at(i)))
        } else {
            std::array::from_fn(|i| T::from_le(at(i)))
        })
    }

    /// The length of a sequence whose elements take at least `min_element_bytes` each: so many
    /// are there, and may be allocated.
    ///
    /// # Errors
    /// [`WireError::Truncated`] when they cannot all be there.
    pub fn sequence_len(
        &mut self,
        field: &'static str,
        min_element_bytes: usize,
    ) -> Result<usize, WireError> {
        let num_elements = self.scalar::<u32>(field)? as usize;
        let available = self.body.len().saturating_sub(self.offset);
        if num_elements > available / min_element_bytes.max(1) {
            return Err(self.truncated(field, num_elements, min_element_bytes));
        }
        Ok(num_elements)
    }

    /// A sequence of elements that `read` reads one by one.
    ///
    /// # Errors
    /// [`WireError`] when they are not there.
    pub fn sequence<T>(
        &mut self,
        field: &'static str,
        min_element_bytes: usize,
        mut read: impl FnMut(&mut Self) -> Result<T, WireError>,
    ) -> Result<Vec<T>, WireError> {
        let num_elements = self.sequence_len(field, min_element_bytes)?;
        // Grown as it fills: an element in memory may be larger than its bytes in the message.
        let mut elements = Vec::new();
        for _ in 0..num_elements {
            elements.push(read(self)?);
        }
        Ok(elements)
    }

    /// A sequence of numbers.
    ///
    /// # Errors
    /// [`WireError::Truncated`] when they are not all there.
    pub fn scalars<T: Scalar>(&mut self, field: &'static str) -> Result<Vec<T>, WireError> {
        let tuples = self.tuples::<T, 1>(field)?;
        Ok(tuples.into_iter().map(|[number]| number).collect())
    }

    /// A sequence of `K` numbers each (points, colours, index triples).
    ///
    /// # Errors
    /// [`WireError::Truncated`] when they are not all there.
    pub fn tuples<T: Scalar, const K: usize>(
        &mut self,
        field: &'static str,
    ) -> Result<Vec<[T; K]>, WireError> {
        let tuple_bytes = K * T::NUM_BYTES;
        let num_tuples = self.sequence_len(field, tuple_bytes)?;
        let bytes = self.take(field, T::NUM_BYTES, num_tuples, tuple_bytes)?;
        let tuples = bytes.chunks_exact(tuple_bytes);
        let number = |tuple: &'a [u8], i: usize| &tuple[i * T::NUM_BYTES..][..T::NUM_BYTES];
        Ok(if self.big_endian {
            tuples
                .map(|t| std::array::from_fn(|i| T::from_be(number(t, i))))
                .collect()
        } else {
            tuples
                .map(|t| std::array::from_fn(|i| T::from_le(number(t, i))))
                .collect()
        })
    }

    /// A sequence of bytes, borrowed.
    ///
    /// # Errors
    /// [`WireError::Truncated`] when they are not all there.
    pub fn bytes(&mut self, field: &'static str) -> Result<&'a [u8], WireError> {
        let num_bytes = self.sequence_len(field, 1)?;
        self.take(field, 1, num_bytes, 1)
    }

    /// A string, borrowed. A length of 0 (no NUL either) is read as empty: some writers do that.
    ///
    /// # Errors
    /// [`WireError`] when it is not there, not UTF-8 or not terminated.
    pub fn string(&mut self, field: &'static str) -> Result<&'a str, WireError> {
        let offset = self.offset + HEADER_BYTES;
        let bytes = self.bytes(field)?;
        let invalid = WireError::String {
            message: self.message,
            field,
            offset,
        };
        match bytes {
            [] => Ok(""),
            [text @ .., 0] => std::str::from_utf8(text).map_err(|_| invalid),
            _ => Err(invalid),
        }
    }
}

/// Writes fields in order.
#[derive(Clone, Debug)]
pub struct CdrWriter {
    bytes: Vec<u8>,
    big_endian: bool,
}

impl CdrWriter {
    /// A writer in the byte order that veneer writes.
    pub fn little_endian() -> Self {
        Self {
            bytes: vec![0, 1, 0, 0],
            big_endian: false,
        }
    }

    /// A writer in the other byte order.
    pub fn big_endian() -> Self {
        Self {
            bytes: vec![0, 0, 0, 0],
            big_endian: true,
        }
    }

    /// The serialised message.
    pub fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }

    fn align(&mut self, align: usize) {
        let body = self.bytes.len() - HEADER_BYTES;
        self.bytes
            .resize(body.next_multiple_of(align) + HEADER_BYTES, 0);
    }

    /// One number.
    pub fn scalar<T: Scalar>(&mut self, number: T) {
        self.align(T::NUM_BYTES);
        number.append(self.big_endian, &mut self.bytes);
    }

    /// A `bool`.
    pub fn bool(&mut self, value: bool) {
        self.scalar(u8::from(value));
    }

    /// A fixed array of numbers.
    pub fn array<T: Scalar, const N: usize>(&mut self, numbers: &[T; N]) {
        for &number in numbers {
            self.scalar(number);
        }
    }

    /// The length of a sequence; its elements follow.
    ///
    /// # Panics
    /// When the sequence is longer than CDR's 32-bit length can say.
    pub fn sequence_len(&mut self, num_elements: usize) {
        let length = u32::try_from(num_elements);
        self.scalar(length.expect("a message's sequences are shorter than 2^32"));
    }

    /// A sequence of `K` numbers each.
    pub fn tuples<T: Scalar, const K: usize>(&mut self, tuples: &[[T; K]]) {
        self.sequence_len(tuples.len());
        if tuples.is_empty() {
            return;
        }
        self.align(T::NUM_BYTES);
        self.bytes.reserve(size_of_val(tuples));
        for &number in tuples.as_flattened() {
            number.append(self.big_endian, &mut self.bytes);
        }
    }

    /// A sequence of numbers.
    pub fn scalars<T: Scalar>(&mut self, numbers: &[T]) {
        self.tuples(numbers.as_chunks::<1>().0);
    }

    /// A sequence of bytes.
    pub fn bytes(&mut self, bytes: &[u8]) {
        self.sequence_len(bytes.len());
        self.bytes.extend_from_slice(bytes);
    }

    /// A string.
    pub fn string(&mut self, text: &str) {
        self.sequence_len(text.len() + 1);
        self.bytes.extend_from_slice(text.as_bytes());
        self.bytes.push(0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_aligned_behind_the_header() {
        // u8, then f64 at body offset 8, then an empty f64 sequence, then a string.
        let bytes = [
            &[0u8, 1, 0, 0][..],
            &[7, 0, 0, 0, 0, 0, 0, 0],
            &1.5f64.to_le_bytes(),
            &[0, 0, 0, 0],
            &[3, 0, 0, 0, b'a', b'b', 0],
        ]
        .concat();
        let mut writer = CdrWriter::little_endian();
        writer.scalar(7u8);
        writer.scalar(1.5f64);
        writer.scalars::<f64>(&[]);
        writer.string("ab");
        assert_eq!(writer.into_bytes(), bytes);
        let mut reader = CdrReader::new("test", &bytes).unwrap();
        assert_eq!(reader.scalar::<u8>("a"), Ok(7));
        assert_eq!(reader.scalar::<f64>("b"), Ok(1.5));
        assert_eq!(reader.scalars::<f64>("c"), Ok(vec![]));
        assert_eq!(reader.string("d"), Ok("ab"));
    }

    #[test]
    fn big_endian_reads_back() {
        let mut writer = CdrWriter::big_endian();
        writer.string("xyz");
        writer.tuples(&[[1u32, 2, 3], [4, 5, 6]]);
        writer.scalar(-2i64);
        let bytes = writer.into_bytes();
        assert_eq!(bytes[..8], [0, 0, 0, 0, 0, 0, 0, 4]);
        let mut reader = CdrReader::new("test", &bytes).unwrap();
        assert_eq!(reader.string("s"), Ok("xyz"));
        assert_eq!(reader.tuples::<u32, 3>("t"), Ok(vec![[1, 2, 3], [4, 5, 6]]));
        assert_eq!(reader.scalar::<i64>("i"), Ok(-2));
    }

    #[test]
    fn a_hostile_length_is_named_not_allocated() {
        let bytes = [0, 1, 0, 0, 0xff, 0xff, 0xff, 0xff, 1, 2];
        let mut reader = CdrReader::new("pkg/msg/Name", &bytes).unwrap();
        let error = reader.tuples::<f64, 3>("points").unwrap_err();
        let words = error.to_string();
        for part in ["pkg/msg/Name.points", "4294967295", "24", "2 are left"] {
            assert!(words.contains(part), "{words}");
        }
    }

    #[test]
    fn only_plain_cdr_is_read() {
        assert!(CdrReader::new("test", &[0, 1, 0]).is_err());
        assert!(CdrReader::new("test", &[0, 3, 0, 0]).is_err());
    }

    #[test]
    fn unterminated_and_non_utf8_strings_are_refused() {
        for text in [&[2, 0, 0, 0, b'a', b'b'][..], &[2, 0, 0, 0, 0xff, 0]] {
            let bytes = [&[0u8, 1, 0, 0][..], text].concat();
            let error = CdrReader::new("test", &bytes).unwrap().string("s");
            assert!(matches!(error, Err(WireError::String { .. })));
        }
    }
}
