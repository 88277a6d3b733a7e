//! Reads a TensorFlow Lite file (a FlatBuffer; tensorflow/lite/schema/schema.fbs) into a [`Network`].
//!
//! A FlatBuffer's table begins with the distance back to its list of fields, which says where in the table each field is, 0 where it is missing.
//! Everything is read by place with a check, so that no file can make it panic.
use ndarray::{Array2, Array4};

use super::{Layer, Network, Step};

/// How a layer treats the picture's border.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Padding {
    /// Zeros around, so that the stride alone makes it smaller.
    Same,
    /// The kernel stays inside.
    Valid,
}

/// Numbers of the layers (`BuiltinOperator`).
mod operator {
    pub(super) const ADD: i32 = 0;
    pub(super) const CONV_2D: i32 = 3;
    pub(super) const DEPTHWISE_CONV_2D: i32 = 4;
    pub(super) const DEQUANTIZE: i32 = 6;
    pub(super) const MAX_POOL_2D: i32 = 17;
    pub(super) const PAD: i32 = 34;
    pub(super) const PRELU: i32 = 54;
}

/// Kinds of numbers (`TensorType`).
const FLOAT32: u8 = 0;
const FLOAT16: u8 = 1;
const INT32: u8 = 2;

type Read<T> = std::result::Result<T, &'static str>;

/// Most values of a network.
const MOST_VALUES: usize = 10_000;

pub(super) fn read(bytes: &[u8]) -> Read<Network> {
    if bytes.get(4..8) != Some(b"TFL3") {
        return Err("no TensorFlow Lite file of version 3");
    }
    let file = Bytes(bytes);
    let model = file.table(0)?;
    let codes = model.tables(1)?;
    let graph = model.tables(2)?.into_iter().next().ok_or("no graph in it")?;
    let buffers = model.tables(4)?;
    let tensors = graph
        .tables(0)?
        .iter()
        .map(|table| Tensor::read(table, &buffers))
        .collect::<Read<Vec<_>>>()?;
    if tensors.len() > MOST_VALUES {
        return Err("too many values");
    }
    // Weights are stored as halves and made floats by a layer of their own: the floats' name stands for the halves.
    let mut stands_for: Vec<usize> = (0..tensors.len()).collect();
    let mut steps = Vec::new();
    for table in graph.tables(3)? {
        let code = codes.get(table.u32(0)? as usize).ok_or("a layer of no kind")?;
        let code = i32::from(code.u8(0)?).max(code.u32(3)? as i32);
        let index = |list: Vec<u32>| -> Read<Vec<usize>> {
            let inside = |n: u32| {
                stands_for
                    .get(n as usize)
                    .copied()
                    .ok_or("a layer reads what is not there")
            };
            list.into_iter().map(inside).collect()
        };
        let from = index(table.numbers(1)?)?;
        let to = *table.numbers(2)?.first().ok_or("a layer that makes nothing")? as usize;
        if to >= tensors.len() {
            return Err("a layer makes what is not there");
        }
        let input = *from.first().ok_or("a layer that reads nothing")?;
        let weights = |k: usize| tensors[*from.get(k).ok_or("a layer without weights")?].floats();
        let options = table.table(4);
        let layer = match code {
            operator::DEQUANTIZE => {
                stands_for[to] = input;
                continue;
            }
            operator::CONV_2D => {
                let options = options?;
                no_activation(&options, 3)?;
                let (shape, values) = weights(1)?;
                let [filters, kernel, across, channels] = shape[..] else {
                    return Err("weights of another shape");
                };
                if kernel != across {
                    return Err("a kernel that is not square");
                }
                // Rows of filters become columns.
                let values = Array4::from_shape_vec((filters, kernel, kernel, channels), values)
                    .map_err(|_| "weights of another shape")?;
                let values = values
                    .into_shape_with_order((filters, kernel * kernel * channels))
                    .map_err(|_| "weights of another shape")?;
                Layer::Convolution {
                    weights: values.reversed_axes().as_standard_layout().into_owned(),
                    bias: weights(2)?.1,
                    kernel,
                    stride: stride(&options)?,
                    padding: padding(&options)?,
                }
            }
            operator::DEPTHWISE_CONV_2D => {
                let options = options?;
                no_activation(&options, 4)?;
                let (shape, values) = weights(1)?;
                let [1, kernel, across, channels] = shape[..] else {
                    return Err("weights of another shape");
                };
                if kernel != across || padding(&options)? != Padding::Same {
                    return Err("a depthwise convolution of another kind");
                }
                Layer::Depthwise {
                    weights: Array2::from_shape_vec((kernel * kernel, channels), values)
                        .map_err(|_| "weights of another shape")?,
                    bias: weights(2)?.1,
                    kernel,
                    stride: stride(&options)?,
                }
            }
            operator::PRELU => Layer::Prelu(weights(1)?.1),
            operator::ADD => {
                no_activation(&options?, 0)?;
                Layer::Add
            }
            operator::MAX_POOL_2D => {
                let options = options?;
                if (options.u32(1)?, options.u32(2)?, options.u32(3)?, options.u32(4)?) != (2, 2, 2, 2) {
                    return Err("a pool that is not 2 × 2");
                }
                Layer::MaxPool
            }
            operator::PAD => {
                let zeros = tensors[*from.get(1).ok_or("a pad without its sizes")?].integers()?;
                match zeros[..] {
                    [0, 0, 0, 0, 0, 0, 0, behind] if behind >= 0 => Layer::Widen(behind as usize),
                    _ => return Err("a pad that does more than widen"),
                }
            }
            _ => return Err("a layer of a kind that is not run here"),
        };
        steps.push(Step { layer, from, to });
    }
    let input = *graph.numbers(1)?.first().ok_or("no input")? as usize;
    let outputs: Vec<usize> = graph.numbers(2)?.into_iter().map(|n| n as usize).collect();
    let [1, height, width, channels] = tensors.get(input).ok_or("no input")?.shape[..] else {
        return Err("an input that is no picture");
    };
    if outputs.iter().any(|n| *n >= tensors.len()) {
        return Err("an output that is not there");
    }
    Ok(Network {
        steps,
        values: tensors.len(),
        input,
        input_shape: [height, width, channels],
        outputs,
    })
}

fn stride(options: &Table) -> Read<usize> {
    match (options.u32(1)?, options.u32(2)?) {
        (across, down) if across == down && across > 0 => Ok(across as usize),
        _ => Err("a stride of another kind"),
    }
}

fn padding(options: &Table) -> Read<Padding> {
    Ok(match options.u8(0)? {
        0 => Padding::Same,
        _ => Padding::Valid,
    })
}

fn no_activation(options: &Table, field: usize) -> Read<()> {
    match options.u8(field)? {
        0 => Ok(()),
        _ => Err("an activation inside a layer"),
    }
}

/// A value that is known when the file is written, or only its shape.
struct Tensor<'a> {
    shape: Vec<usize>,
    kind: u8,
    bytes: &'a [u8],
}

impl<'a> Tensor<'a> {
    fn read(table: &Table<'a>, buffers: &[Table<'a>]) -> Read<Self> {
        let buffer = buffers
            .get(table.u32(2)? as usize)
            .ok_or("a value without its buffer")?;
        Ok(Self {
            shape: table.numbers(0)?.into_iter().map(|n| n as usize).collect(),
            kind: table.u8(1)?,
            bytes: buffer.bytes(0)?,
        })
    }

    /// Shape and numbers of weights.
    fn floats(&self) -> Read<(Vec<usize>, Vec<f32>)> {
        let values: Vec<f32> = match self.kind {
            FLOAT32 => self
                .bytes
                .as_chunks()
                .0
                .iter()
                .map(|b| f32::from_le_bytes(*b))
                .collect(),
            FLOAT16 => self
                .bytes
                .as_chunks()
                .0
                .iter()
                .map(|b| half(u16::from_le_bytes(*b)))
                .collect(),
            _ => return Err("weights that are no floats"),
        };
        // No product of sizes is larger than the file.
        let count = self
            .shape
            .iter()
            .try_fold(1usize, |product, n| product.checked_mul(*n));
        match count == Some(values.len()) {
            true => Ok((self.shape.clone(), values)),
            false => Err("weights of another size than their shape"),
        }
    }

    fn integers(&self) -> Read<Vec<i32>> {
        match self.kind {
            INT32 => Ok(self
                .bytes
                .as_chunks()
                .0
                .iter()
                .map(|b| i32::from_le_bytes(*b))
                .collect()),
            _ => Err("sizes that are no integers"),
        }
    }
}

/// A number of 16 bits (IEEE 754): sign, five bits of exponent, ten of fraction.
fn half(bits: u16) -> f32 {
    let (sign, exponent, fraction) = (
        f32::from(1 - 2 * (bits >> 15) as i16),
        bits >> 10 & 31,
        f32::from(bits & 1023),
    );
    sign * match exponent {
        0 => fraction * 2f32.powi(-24),
        31 => f32::NAN,
        exponent => (1.0 + fraction / 1024.0) * 2f32.powi(i32::from(exponent) - 15),
    }
}

/// The whole file.
#[derive(Clone, Copy)]
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn array<const N: usize>(self, at: usize) -> Read<[u8; N]> {
        let found = at.checked_add(N).and_then(|end| self.0.get(at..end));
        found
            .and_then(|bytes| bytes.try_into().ok())
            .ok_or("it is cut short")
    }

    fn u32(self, at: usize) -> Read<u32> {
        Ok(u32::from_le_bytes(self.array(at)?))
    }

    /// The place that the number at `at` points to.
    fn target(self, at: usize) -> Read<usize> {
        at.checked_add(self.u32(at)? as usize)
            .filter(|to| *to < self.0.len())
            .ok_or("it points outside")
    }

    /// The table that the number at `at` points to.
    fn table(self, at: usize) -> Read<Table<'a>> {
        let place = self.target(at)?;
        let back = i32::from_le_bytes(self.array(place)?);
        let fields = (place as i64 - i64::from(back))
            .try_into()
            .map_err(|_| "it points outside")?;
        Ok(Table {
            file: self,
            place,
            fields,
        })
    }
}

/// A table of the file.
#[derive(Clone, Copy)]
struct Table<'a> {
    file: Bytes<'a>,
    place: usize,
    /// Where its list of fields is.
    fields: usize,
}

impl<'a> Table<'a> {
    /// Place of a field; None where it has its default.
    fn field(&self, number: usize) -> Read<Option<usize>> {
        let size = u16::from_le_bytes(self.file.array(self.fields)?);
        let entry = 4 + 2 * number;
        if entry + 2 > usize::from(size) {
            return Ok(None);
        }
        let offset = u16::from_le_bytes(self.file.array(self.fields + entry)?);
        Ok((offset > 0).then(|| self.place + usize::from(offset)))
    }

    fn u8(&self, number: usize) -> Read<u8> {
        self.field(number)?
            .map_or(Ok(0), |at| Ok(self.file.array::<1>(at)?[0]))
    }

    fn u32(&self, number: usize) -> Read<u32> {
        self.field(number)?.map_or(Ok(0), |at| self.file.u32(at))
    }

    fn table(&self, number: usize) -> Read<Table<'a>> {
        self.file.table(self.field(number)?.ok_or("a table is missing")?)
    }

    /// Place and length of a list's items, which have `size` bytes each; none where there is no list.
    fn list(&self, number: usize, size: usize) -> Read<(usize, usize)> {
        let Some(at) = self.field(number)? else {
            return Ok((0, 0));
        };
        let place = self.file.target(at)?;
        let length = self.file.u32(place)? as usize;
        let end = length
            .checked_mul(size)
            .and_then(|bytes| bytes.checked_add(place + 4));
        match end.is_some_and(|end| end <= self.file.0.len()) {
            true => Ok((place + 4, length)),
            false => Err("a list is cut short"),
        }
    }

    fn numbers(&self, number: usize) -> Read<Vec<u32>> {
        let (place, length) = self.list(number, 4)?;
        (0..length).map(|k| self.file.u32(place + 4 * k)).collect()
    }

    fn tables(&self, number: usize) -> Read<Vec<Table<'a>>> {
        let (place, length) = self.list(number, 4)?;
        (0..length).map(|k| self.file.table(place + 4 * k)).collect()
    }

    fn bytes(&self, number: usize) -> Read<&'a [u8]> {
        let (place, length) = self.list(number, 1)?;
        Ok(&self.file.0[place..place + length])
    }
}

#[cfg(test)]
mod tests {
    use super::half;

    #[test]
    fn halves_are_numbers() {
        for (bits, value) in [
            (0x3c00, 1.0),
            (0xc000, -2.0),
            (0x3555, 0.333_251_95),
            (0x0001, 5.960_464_5e-8),
            (0, 0.0),
        ] {
            assert_eq!(half(bits), value);
        }
    }
}
