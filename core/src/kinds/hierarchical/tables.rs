//! The sections of a hierarchical model, and their writers. Areas lie one after the other in every section, in the order of the groups; K, M and C are an area's own.
use super::Hierarchical;
use crate::context::ContextTables;
use crate::context::tables::PROJECTION_SHIFT;
use crate::frame::MAX_GROUPS;
use crate::model::container::{Section, Sections, check};
use crate::model::{Head, I16s, ModelError, U16s, put_i16s, put_u16s, u16_at};

/// `[A]` of (clusters K u16, components M u16): one for each group. Clusters with fewer components than M have rows of zeros.
pub const AREAS: Section = Section::new(0x3000, "Areas");
/// i16 `[K][S]`, Q5.10 deviations: s̄, the mean speech of each cluster.
pub const SPEECH_MEANS: Section = Section::new(0x3001, "SpeechMeans");
/// i16 `[K][M][S]`: mantissas of G; the sizes of a row's add up to less than 2¹⁶.
pub const SPEECH_WEIGHTS: Section = Section::new(0x3002, "SpeechWeights");
/// u8 `[K][M]`: the sum of a row is shifted down by this.
pub const SPEECH_SHIFTS: Section = Section::new(0x3003, "SpeechShifts");
/// i16 `[K][C]`, parameter LSBs: c̄, the mean appearance of each cluster.
pub const APPEARANCE_MEANS: Section = Section::new(0x3004, "AppearanceMeans");
/// u16 `[K][C]`, parameter LSBs: how far an appearance may be from the mean.
pub const APPEARANCE_LIMITS: Section = Section::new(0x3005, "AppearanceLimits");
/// i16 `[K][M][C]`, eighths of a parameter LSB for a deviation of a component: H.
pub const APPEARANCE_WEIGHTS: Section = Section::new(0x3006, "AppearanceWeights");

/// Most clusters of an area.
pub const MAX_CLUSTERS: usize = 256;
/// Most components of a cluster: as many products of 3·2¹⁰ and 2¹⁵ fit 32 bits.
pub const MAX_MODES: usize = 16;
/// Most speech parameters: so many squares of [`MAX_OFF`](super::area::MAX_OFF) fit 32 bits.
pub const MAX_SPEECH: usize = 16;
/// Largest right shift of a row of G.
pub const MAX_SPEECH_SHIFT: u8 = 30;
/// Fraction bits of speech parameters and of d.
pub const SIGNAL_FRACTION_BITS: u32 = 10;
/// Fraction bits of H.
pub const APPEARANCE_FRACTION_BITS: u32 = 3;

const AREA_SIZE: usize = 4;

/// The tables of one area.
#[derive(Clone, Copy, Debug)]
pub struct Area<'a> {
    /// K.
    pub clusters: usize,
    /// M.
    pub modes: usize,
    /// C.
    pub size: usize,
    /// S.
    pub speech: usize,
    speech_means: I16s<'a>,
    speech_weights: I16s<'a>,
    speech_shifts: &'a [u8],
    appearance_means: I16s<'a>,
    appearance_limits: U16s<'a>,
    appearance_weights: I16s<'a>,
}

impl<'a> Area<'a> {
    const NONE: Self = Self {
        clusters: 0,
        modes: 0,
        size: 0,
        speech: 0,
        speech_means: I16s(&[]),
        speech_weights: I16s(&[]),
        speech_shifts: &[],
        appearance_means: I16s(&[]),
        appearance_limits: U16s(&[]),
        appearance_weights: I16s(&[]),
    };

    /// s̄ of all clusters, one after the other `[K][S]`.
    #[inline]
    pub fn speech_means(&self) -> I16s<'a> {
        self.speech_means
    }

    /// Row of G of a cluster's component, and its shift.
    #[inline]
    pub fn speech_row(&self, cluster: usize, mode: usize) -> (I16s<'a>, u32) {
        let row = cluster * self.modes + mode;
        let shift = self.speech_shifts.get(row).copied().unwrap_or(0);
        (self.speech_weights.row(row, self.speech), u32::from(shift))
    }

    /// c̄ of a cluster and how far from it an appearance may be.
    #[inline]
    pub fn appearance(&self, cluster: usize) -> (I16s<'a>, U16s<'a>) {
        (
            self.appearance_means.row(cluster, self.size),
            self.appearance_limits.row(cluster, self.size),
        )
    }

    /// Column of H of a cluster's component, `[C]`.
    #[inline]
    pub fn appearance_row(&self, cluster: usize, mode: usize) -> I16s<'a> {
        self.appearance_weights
            .row(cluster * self.modes + mode, self.size)
    }
}

/// Writes one area into [`AREAS`].
pub fn put_area(to: &mut impl Extend<u8>, clusters: u16, modes: u16) {
    put_u16s(to, [clusters, modes]);
}

/// Writes s̄ of one cluster.
pub fn put_speech_mean(to: &mut impl Extend<u8>, mean: impl IntoIterator<Item = i16>) {
    put_i16s(to, mean);
}

/// Writes a row of G into its two sections.
pub fn put_speech_row<E: Extend<u8>>(
    [weights, shifts]: [&mut E; 2],
    row: impl IntoIterator<Item = i16>,
    shift: u8,
) {
    put_i16s(weights, row);
    shifts.extend([shift]);
}

/// Writes c̄ of one cluster and its limits into their two sections.
pub fn put_appearance<E: Extend<u8>>(
    [means, limits]: [&mut E; 2],
    mean: impl IntoIterator<Item = i16>,
    limit: impl IntoIterator<Item = u16>,
) {
    put_i16s(means, mean);
    put_u16s(limits, limit);
}

/// Writes a column of H.
pub fn put_appearance_row(to: &mut impl Extend<u8>, row: impl IntoIterator<Item = i16>) {
    put_i16s(to, row);
}

pub(super) fn read<'a>(sections: &mut Sections<'a>, head: &Head<'a>) -> Result<Hierarchical<'a>, ModelError> {
    let context = ContextTables::read(sections, 0)?;
    let speech = context.n_inputs();
    if speech > MAX_SPEECH {
        return Err(ModelError::Size {
            section: PROJECTION_SHIFT,
            have: speech,
            most: MAX_SPEECH,
        });
    }
    let n_areas = head.groups().count();
    let areas_bytes = sections.take_sized(AREAS, AREA_SIZE * n_areas)?;
    let mut areas = [Area::NONE; MAX_GROUPS];
    for ((area, group), item) in areas
        .iter_mut()
        .zip(head.groups())
        .zip(areas_bytes.as_chunks::<AREA_SIZE>().0)
    {
        area.clusters = usize::from(u16_at(item, 0));
        area.modes = usize::from(u16_at(item, 2));
        area.size = group.place.len();
        area.speech = speech;
    }
    let known = areas.get(..n_areas).unwrap_or(&[]);
    check(
        AREAS,
        known
            .iter()
            .map(|area| (1..=MAX_CLUSTERS).contains(&area.clusters) && area.modes <= MAX_MODES),
    )?;
    // Every area's share of a section, in bytes.
    let share = |area: &Area, section: Section| {
        let rows = area.clusters * area.modes;
        match section {
            SPEECH_MEANS => 2 * area.clusters * speech,
            SPEECH_WEIGHTS => 2 * rows * speech,
            SPEECH_SHIFTS => rows,
            APPEARANCE_WEIGHTS => 2 * rows * area.size,
            _ => 2 * area.clusters * area.size,
        }
    };
    let wanted = |section: Section| known.iter().map(|area| share(area, section)).sum();
    let all = [
        SPEECH_MEANS,
        SPEECH_WEIGHTS,
        SPEECH_SHIFTS,
        APPEARANCE_MEANS,
        APPEARANCE_LIMITS,
        APPEARANCE_WEIGHTS,
    ];
    let mut rest: [&[u8]; 6] = [&[]; 6];
    for (bytes, section) in rest.iter_mut().zip(all) {
        *bytes = sections.take_sized(section, wanted(section))?;
    }
    let [_, weights, shifts, ..] = rest;
    check(SPEECH_SHIFTS, shifts.iter().map(|s| *s <= MAX_SPEECH_SHIFT))?;
    // Sums in 32 bits: 2¹⁴ times less than 2¹⁶.
    check(
        SPEECH_WEIGHTS,
        weights.chunks_exact(2 * speech.max(1)).map(|row| {
            let sizes = I16s(row).iter().map(|w| u32::from(w.unsigned_abs()));
            sizes.sum::<u32>() < 1 << 16
        }),
    )?;
    for area in areas.iter_mut().take(n_areas) {
        let sizes = all.map(|section| share(area, section));
        let mut own: [&[u8]; 6] = [&[]; 6];
        for ((own, rest), size) in own.iter_mut().zip(&mut rest).zip(sizes) {
            let (first, behind) = rest.split_at_checked(size).unwrap_or((&[], &[]));
            (*own, *rest) = (first, behind);
        }
        let [means, weights, shifts, appearances, limits, rows] = own;
        *area = Area {
            speech_means: I16s(means),
            speech_weights: I16s(weights),
            speech_shifts: shifts,
            appearance_means: I16s(appearances),
            appearance_limits: U16s(limits),
            appearance_weights: I16s(rows),
            ..*area
        };
    }
    Ok(Hierarchical {
        context,
        areas,
        n_areas,
    })
}
