//! Hierarchical models: the second paper's face, clusters of appearance and speech chosen picture by picture (Cosker, Marshall, Rosin and Hicks 2004, COS). The lightest
//! kind: nothing is followed, a picture of 40 ms costs one cluster choice and one small map an area. Live, in fixed point; the twin in floats is the host's.
//!
//! With x_n the statics at the taps around the frame that begins picture n, in every area of the face:
//!
//! ```text
//! s_n = V x_n − b                                                [`crate::context`]
//! k_n = argmin_k |s_n − s̄_k|²                                    eq. 8
//! d_n = G_k (s_n − s̄_k), held to ±3                              eq. 11
//! c_n = c̄_k + H_k d_n, held to three deviations around c̄_k       eq. 9 and 10
//! y_n = ¼ c_{n−1} + ½ c_n + ¼ c_{n+1}                            end of section 4.4
//! ```
//!
//! s is in standard deviations of training speech, so that the Mahalanobis distance of eq. 8, whose covariance is diagonal, is a plain square; d is in standard deviations of a
//! cluster's component. Frames lie on lines between the middles of pictures. [`area`] has the equations, [`converter`] pictures and frames, [`tables`] what they read.
pub mod area;
pub mod converter;
pub mod tables;

pub use converter::Converter;

use super::{Kind, sealed::Sealed};
use crate::context::ContextTables;
use crate::frame::MAX_GROUPS;
use crate::model::container::Sections;
use crate::model::{Head, ModelError};
use crate::settings::Setting;
use tables::Area;

/// Frames of the front end in a picture: 25 pictures a second.
pub const PICTURE_FRAMES: u32 = 4;

/// The tables of a hierarchical model.
#[derive(Clone, Copy, Debug)]
pub struct Hierarchical<'a> {
    context: ContextTables<'a>,
    areas: [Area<'a>; MAX_GROUPS],
    n_areas: usize,
}

impl Sealed for Hierarchical<'_> {}

impl<'a> Kind<'a> for Hierarchical<'a> {
    const TAG: u16 = 3;
    const NAME: &'static str = "Hierarchical";
    type Converter = Converter<'a>;

    fn read(sections: &mut Sections<'a>, head: &Head<'a>) -> Result<Self, ModelError> {
        tables::read(sections, head)
    }

    fn understands(&self, setting: Setting) -> bool {
        setting == Setting::Average
    }

    fn n_visemes(&self) -> usize {
        0
    }
}

impl<'a> Hierarchical<'a> {
    /// Taps and projection: speech parameters in Q5.10 standard deviations.
    #[inline]
    pub fn context(&self) -> &ContextTables<'a> {
        &self.context
    }

    /// The areas of the face, one for each group of a frame's parameters and in their order.
    #[inline]
    pub fn areas(&self) -> &[Area<'a>] {
        self.areas.get(..self.n_areas).unwrap_or(&[])
    }
}
