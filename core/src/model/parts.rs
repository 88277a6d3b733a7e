//! Numbers in sections: read where they lie, and written. Everything is little-endian.

/// Little-endian i16 in a byte slice.
#[derive(Clone, Copy, Debug)]
pub struct I16s<'a>(pub(crate) &'a [u8]);

impl<'a> I16s<'a> {
    /// Number `index`, 0 beyond the end.
    #[inline]
    pub fn get(self, index: usize) -> i16 {
        match self.0.get(2 * index..2 * index + 2) {
            Some(&[a, b]) => i16::from_le_bytes([a, b]),
            _ => 0,
        }
    }

    /// The numbers as they lie there.
    #[inline]
    pub fn bytes(self) -> &'a [u8] {
        self.0
    }

    /// The numbers in order.
    #[inline]
    pub fn iter(self) -> impl ExactSizeIterator<Item = i16> + 'a {
        self.0.as_chunks().0.iter().map(|b| i16::from_le_bytes(*b))
    }

    /// Numbers `row·width .. (row + 1)·width`, empty beyond the end.
    #[inline]
    pub fn row(self, row: usize, width: usize) -> Self {
        let start = 2 * row * width;
        Self(self.0.get(start..start + 2 * width).unwrap_or(&[]))
    }
}

/// Little-endian u16 in a byte slice.
#[derive(Clone, Copy, Debug)]
pub struct U16s<'a>(pub(crate) &'a [u8]);

impl<'a> U16s<'a> {
    /// The numbers in order.
    #[inline]
    pub fn iter(self) -> impl ExactSizeIterator<Item = u16> + 'a {
        self.0.as_chunks().0.iter().map(|b| u16::from_le_bytes(*b))
    }

    /// Numbers `row·width .. (row + 1)·width`, empty beyond the end.
    #[inline]
    pub fn row(self, row: usize, width: usize) -> Self {
        let start = 2 * row * width;
        Self(self.0.get(start..start + 2 * width).unwrap_or(&[]))
    }
}

/// The i32 of a section.
pub(crate) fn i32s(bytes: &[u8]) -> impl Iterator<Item = i32> + '_ {
    bytes.as_chunks().0.iter().map(|b| i32::from_le_bytes(*b))
}

pub(crate) fn u16_at(bytes: &[u8], at: usize) -> u16 {
    match bytes.get(at..at + 2) {
        Some(&[a, b]) => u16::from_le_bytes([a, b]),
        _ => 0,
    }
}

pub(crate) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    match bytes.get(at..at + 4) {
        Some(&[a, b, c, d]) => u32::from_le_bytes([a, b, c, d]),
        _ => 0,
    }
}

macro_rules! putters {
    ($($name:ident $number:ty),*) => {
        $(
            #[doc = concat!("Writes `", stringify!($number), "` as sections hold them.")]
            pub fn $name(to: &mut impl Extend<u8>, values: impl IntoIterator<Item = $number>) {
                to.extend(values.into_iter().flat_map(<$number>::to_le_bytes));
            }
        )*
    };
}

putters! { put_i16s i16, put_u16s u16, put_i32s i32, put_u32s u32, put_f32s f32 }
