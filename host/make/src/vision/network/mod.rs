//! Runs a small convolutional network in floats: as many kinds of layers as the face landmarks need, no more.
//!
//! Pictures are `[height, width, channels]`. A convolution is one matrix product over the picture's patches, so that nearly all of the
//! time is spent in `ndarray`'s product.
mod tflite;

use ndarray::{Array2, Array3, ArrayView3, CowArray, s};

use crate::error::{Error, Result};
use tflite::Padding;

/// One step: which values it reads, which it makes.
struct Step {
    layer: Layer,
    from: Vec<usize>,
    to: usize,
}

enum Layer {
    /// Weights `[kernel·kernel·in, out]`, the kernel's rows first, and what is added.
    Convolution {
        weights: Array2<f32>,
        bias: Vec<f32>,
        kernel: usize,
        stride: usize,
        padding: Padding,
    },
    /// Weights `[kernel·kernel][channels]`: every channel by itself.
    Depthwise {
        weights: Array2<f32>,
        bias: Vec<f32>,
        kernel: usize,
        stride: usize,
    },
    /// Negative values times a channel's slope.
    Prelu(Vec<f32>),
    Add,
    /// The largest of 2 × 2.
    MaxPool,
    /// Channels of zeros behind.
    Widen(usize),
}

/// A network.
pub(crate) struct Network {
    steps: Vec<Step>,
    /// Number of values, the input among them.
    values: usize,
    input: usize,
    /// `[height, width, channels]`.
    input_shape: [usize; 3],
    outputs: Vec<usize>,
}

impl Network {
    /// The network in a TensorFlow Lite file.
    ///
    /// # Errors
    ///
    /// That the file is damaged, or holds layers of other kinds.
    pub(crate) fn of_tflite(bytes: &[u8]) -> Result<Self> {
        tflite::read(bytes).map_err(|what| Error::File(format!("the network's file: {what}")))
    }

    /// Height and width of its pictures.
    pub(crate) fn size(&self) -> (usize, usize) {
        (self.input_shape[0], self.input_shape[1])
    }

    /// All outputs for a picture, in the file's order.
    ///
    /// # Errors
    ///
    /// That the picture has another size than the network's.
    pub(crate) fn run(&self, picture: Array3<f32>) -> Result<Vec<Array3<f32>>> {
        let (height, width, channels) = picture.dim();
        if [height, width, channels] != self.input_shape {
            return Err(Error::Data(format!(
                "a picture of {width}×{height} pixels for a network of {}×{}",
                self.input_shape[1], self.input_shape[0]
            )));
        }
        let mut values: Vec<Option<Array3<f32>>> = (0..self.values).map(|_| None).collect();
        values[self.input] = Some(picture);
        for step in &self.steps {
            let made = {
                let read = |k: usize| values.get(*step.from.get(k)?)?.as_ref().map(|value| value.view());
                let first = read(0).ok_or_else(missing)?;
                match &step.layer {
                    Layer::Convolution {
                        weights,
                        bias,
                        kernel,
                        stride,
                        padding,
                    } => convolution(first, weights, bias, *kernel, *stride, *padding),
                    Layer::Depthwise {
                        weights,
                        bias,
                        kernel,
                        stride,
                    } => depthwise(first, weights, bias, *kernel, *stride),
                    Layer::Prelu(slopes) => prelu(first, slopes),
                    Layer::Add => &first + &read(1).ok_or_else(missing)?,
                    Layer::MaxPool => max_pool(first),
                    Layer::Widen(channels) => widen(first, *channels),
                }
            };
            values[step.to] = Some(made);
        }
        let output = |k: &usize| values[*k].take().ok_or_else(missing);
        self.outputs.iter().map(output).collect()
    }
}

fn missing() -> Error {
    Error::File("the network's file: a layer reads what none has made".into())
}

/// Size of what comes out, and zeros before the picture, of one side.
fn sides(size: usize, kernel: usize, stride: usize, padding: Padding) -> (usize, usize) {
    match padding {
        Padding::Valid => ((size + stride).saturating_sub(kernel) / stride, 0),
        Padding::Same => {
            let out = size.div_ceil(stride);
            let zeros = ((out.max(1) - 1) * stride + kernel).saturating_sub(size);
            (out, zeros / 2)
        }
    }
}

fn convolution(
    picture: ArrayView3<f32>,
    weights: &Array2<f32>,
    bias: &[f32],
    kernel: usize,
    stride: usize,
    padding: Padding,
) -> Array3<f32> {
    let (height, width, channels) = picture.dim();
    let (rows, above) = sides(height, kernel, stride, padding);
    let (columns, left) = sides(width, kernel, stride, padding);
    let patches = match (kernel, stride) {
        // Its pixels are its patches.
        (1, 1) => picture
            .into_shape_with_order((height * width, channels))
            .map(CowArray::from)
            .ok(),
        _ => None,
    };
    let patches = patches.unwrap_or_else(|| {
        let mut patches = Array2::zeros((rows * columns, kernel * kernel * channels));
        for (number, mut patch) in patches.outer_iter_mut().enumerate() {
            let (y, x) = (number / columns * stride, number % columns * stride);
            let Some(patch) = patch.as_slice_mut() else {
                continue;
            };
            for (part, to) in patch.chunks_exact_mut(channels).enumerate() {
                let (y, x) = (y + part / kernel, x + part % kernel);
                if let (Some(y), Some(x)) = (y.checked_sub(above), x.checked_sub(left))
                    && y < height
                    && x < width
                {
                    to.iter_mut()
                        .zip(picture.slice(s![y, x, ..]))
                        .for_each(|(to, from)| *to = *from);
                }
            }
        }
        CowArray::from(patches)
    });
    let mut out = patches.dot(weights);
    for mut pixel in out.outer_iter_mut() {
        pixel.iter_mut().zip(bias).for_each(|(v, b)| *v += b);
    }
    let filters = out.ncols();
    out.into_shape_with_order((rows, columns, filters))
        .unwrap_or_default()
}

fn depthwise(
    picture: ArrayView3<f32>,
    weights: &Array2<f32>,
    bias: &[f32],
    kernel: usize,
    stride: usize,
) -> Array3<f32> {
    let (height, width, channels) = picture.dim();
    let (rows, above) = sides(height, kernel, stride, Padding::Same);
    let (columns, left) = sides(width, kernel, stride, Padding::Same);
    let mut out = vec![0.0f32; rows * columns * channels];
    let from = picture.as_standard_layout();
    let (Some(from), Some(weights)) = (from.as_slice(), weights.as_slice()) else {
        return Array3::zeros((rows, columns, channels));
    };
    for (number, pixel) in out.chunks_exact_mut(channels).enumerate() {
        let (y, x) = (number / columns * stride, number % columns * stride);
        pixel.copy_from_slice(bias);
        for (part, own) in weights.chunks_exact(channels).enumerate() {
            let (Some(fy), Some(fx)) = (
                (y + part / kernel).checked_sub(above),
                (x + part % kernel).checked_sub(left),
            ) else {
                continue;
            };
            if fy < height && fx < width {
                let from = &from[(fy * width + fx) * channels..][..channels];
                pixel
                    .iter_mut()
                    .zip(from)
                    .zip(own)
                    .for_each(|((v, f), w)| *v += f * w);
            }
        }
    }
    Array3::from_shape_vec((rows, columns, channels), out).unwrap_or_default()
}

fn prelu(picture: ArrayView3<f32>, slopes: &[f32]) -> Array3<f32> {
    let mut out = picture.as_standard_layout().into_owned();
    for pixel in out
        .as_slice_mut()
        .unwrap_or_default()
        .chunks_exact_mut(slopes.len().max(1))
    {
        for (value, slope) in pixel.iter_mut().zip(slopes) {
            *value = value.max(0.0) + slope * value.min(0.0);
        }
    }
    out
}

fn max_pool(picture: ArrayView3<f32>) -> Array3<f32> {
    let (height, width, channels) = picture.dim();
    Array3::from_shape_fn((height / 2, width / 2, channels), |(y, x, c)| {
        let four = [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(dy, dx)| picture[(2 * y + dy, 2 * x + dx, c)]);
        four.into_iter().fold(f32::NEG_INFINITY, f32::max)
    })
}

fn widen(picture: ArrayView3<f32>, channels: usize) -> Array3<f32> {
    let (height, width, own) = picture.dim();
    let mut out = Array3::zeros((height, width, own + channels));
    out.slice_mut(s![.., .., ..own]).assign(&picture);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn sides_are_as_tensorflow_counts_them() {
        assert_eq!(sides(192, 3, 2, Padding::Same), (96, 0));
        assert_eq!(sides(96, 3, 1, Padding::Same), (96, 1));
        assert_eq!(sides(5, 3, 2, Padding::Same), (3, 1));
        assert_eq!(sides(3, 3, 1, Padding::Valid), (1, 0));
        assert_eq!(sides(48, 2, 2, Padding::Valid), (24, 0));
    }

    /// Against sums written out by hand.
    #[test]
    fn layers_do_what_they_say() {
        let picture = Array3::from_shape_fn((3, 3, 1), |(y, x, _)| (3 * y + x) as f32);
        // The middle and the right neighbour.
        let weights = Array2::from_shape_fn((9, 1), |(k, _)| {
            f32::from(u8::from(k == 4)) + if k == 5 { 10.0 } else { 0.0 }
        });
        let out = convolution(picture.view(), &weights, &[0.5], 3, 1, Padding::Same);
        assert_eq!(
            out.iter().copied().collect::<Vec<_>>(),
            [10.5, 21.5, 2.5, 43.5, 54.5, 5.5, 76.5, 87.5, 8.5]
        );
        let alone = depthwise(picture.view(), &weights, &[0.5], 3, 1);
        assert_eq!(alone, out);
        let every_second = depthwise(picture.view(), &weights, &[0.5], 3, 2);
        assert_eq!(every_second, out.slice(s![..;2, ..;2, ..]));
        let signed = array![[[-2.0f32, 3.0]]];
        assert_eq!(prelu(signed.view(), &[0.5, 0.5]), array![[[-1.0, 3.0]]]);
        assert_eq!(widen(signed.view(), 1), array![[[-2.0, 3.0, 0.0]]]);
        assert_eq!(
            max_pool(Array3::from_shape_fn((2, 2, 1), |(y, x, _)| (y + 2 * x) as f32).view()),
            array![[[3.0]]]
        );
    }

    #[test]
    fn what_is_no_network_is_refused() {
        for bytes in [&b""[..], b"TFL3", &[0xff; 64], &[0; 64]] {
            assert!(Network::of_tflite(bytes).is_err());
        }
    }
}
