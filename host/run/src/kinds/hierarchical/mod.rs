//! The hierarchical speech-appearance model of Cosker, Marshall, Rosin and Hicks 2004 (COS): a tree of facial areas, in each of which clusters map speech to
//! appearance, picture by picture; from the parts a whole face is composed. `docs/hierarchical.md` has the way of the data.
use std::path::Path;

use ndarray::{Array1, Array2, ArrayView1, Axis, concatenate, s};
use serde::{Deserialize, Serialize};

use crate::error::{Context as _, Error, Result, bail};
use crate::mouth::MouthSpace;
use crate::tensors::{Tensors, TensorsBuilder};
use crate::time;

pub mod appearance;
pub mod clusters;
mod compose;
pub mod drawn;
pub mod guide;
pub mod linear;
pub mod mesh;
pub mod speech;
pub mod voice;
pub mod yiq;

pub use appearance::Appearance;
pub use clusters::{Cluster, SpeechMap};
pub use compose::Part;
pub use guide::{Choice, Guide};
pub use linear::Linear;
pub use speech::Hearing;

/// What the file's note `kind` says.
pub const KIND: &str = "hierarchical";
/// Version of the file.
const VERSION: u32 = 1;

/// An area of the face in the tree.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Area {
    /// What it is called: "face", "mouth".
    pub name: String,
    /// The area that it is a part of; none of the root, which is named first.
    #[serde(default)]
    pub parent: Option<String>,
    /// Its landmarks, as the landmark files count them; all of them where none are named.
    #[serde(default)]
    pub landmarks: Vec<usize>,
}

/// A tree of areas, parents before their children.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tree {
    /// The root first.
    pub areas: Vec<Area>,
}

impl Tree {
    /// The paper's tree: the face, and its mouth with these landmarks.
    pub fn face_and_mouth(mouth: impl IntoIterator<Item = usize>) -> Self {
        let area = |name: &str, parent: Option<&str>, landmarks| Area {
            name: name.to_owned(),
            parent: parent.map(str::to_owned),
            landmarks,
        };
        Self {
            areas: vec![
                area("face", None, Vec::new()),
                area("mouth", Some("face"), mouth.into_iter().collect()),
            ],
        }
    }

    /// The same tree with the landmarks of every area named, out of `count`.
    ///
    /// # Errors
    ///
    /// [`Error::Choice`]: it is no tree over so many landmarks.
    pub fn over(&self, count: usize) -> Result<Self> {
        let mut whole = self.clone();
        let mut names: Vec<&str> = Vec::new();
        for (index, (area, wanted)) in whole.areas.iter_mut().zip(&self.areas).enumerate() {
            if area.landmarks.is_empty() {
                area.landmarks = (0..count).collect();
            }
            let name = &wanted.name;
            let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
            if name.is_empty() || !name.chars().all(plain) || names.contains(&name.as_str()) {
                bail!(
                    Choice,
                    "area {index} is called {name:?}: give every area a name of its own, of letters, digits, - and _"
                );
            }
            match (&wanted.parent, index) {
                (None, 0) => {}
                (Some(parent), 1..) if names.contains(&parent.as_str()) => {
                    let of_parent = self.areas.iter().find(|a| a.name == *parent);
                    let inside = |k: &usize| {
                        of_parent.is_some_and(|p| p.landmarks.is_empty() || p.landmarks.contains(k))
                    };
                    if let Some(k) = area.landmarks.iter().find(|k| !inside(k)) {
                        bail!(Choice, "landmark {k} of {name} is none of its parent {parent}");
                    }
                }
                _ => bail!(
                    Choice,
                    "{name}: the first area is the root and has no parent; every other names one that stands before it"
                ),
            }
            if let Some(k) = area.landmarks.iter().find(|k| **k >= count) {
                bail!(
                    Choice,
                    "{name} has landmark {k}; there are {count}, counted from 0"
                );
            }
            let mut sorted = area.landmarks.clone();
            sorted.sort_unstable();
            sorted.dedup();
            if sorted.len() != area.landmarks.len() || sorted.len() < 3 {
                bail!(
                    Choice,
                    "{name} needs three landmarks at least, none of them twice"
                );
            }
            names.push(name);
        }
        if whole.areas.is_empty() {
            bail!(Choice, "the tree has no area");
        }
        Ok(whole)
    }

    /// Index of the parent of each area.
    fn parents(&self) -> Vec<Option<usize>> {
        let at = |name: &String| self.areas.iter().position(|area| area.name == *name);
        self.areas
            .iter()
            .map(|area| area.parent.as_ref().and_then(at))
            .collect()
    }
}

/// One area, modelled.
#[derive(Clone, Debug)]
pub struct Node {
    /// What it looks like.
    pub appearance: Appearance,
    /// What speech makes of it.
    pub map: SpeechMap,
}

/// Colour of the training pictures of the root (section 5): the chroma of the nearest one is given to a picture that was composed.
#[derive(Clone, Debug, PartialEq)]
pub struct Colours {
    /// Appearance c of the root in each training picture, `[n, C]`.
    pub appearances: Array2<f32>,
    /// I and Q of each picture in the mean shape at half its size, as cameras record colour, `[n, 2 × pixels]`.
    pub chroma: Array2<f32>,
}

/// A trained model, ready to convert and to draw. Its pieces can be looked at, not changed: how parts lie in each other follows from them.
#[derive(Clone, Debug)]
pub struct HierarchicalModel {
    pieces: Pieces,
    inlays: Vec<Option<(usize, Vec<usize>, compose::Inlay)>>,
}

impl std::ops::Deref for HierarchicalModel {
    type Target = Pieces;

    fn deref(&self) -> &Pieces {
        &self.pieces
    }
}

/// What a model is made of.
#[derive(Clone, Debug)]
pub struct Pieces {
    /// Areas with their landmarks named, by [`Tree::over`].
    pub tree: Tree,
    /// A node for each area.
    pub nodes: Vec<Node>,
    /// What is heard of each picture.
    pub hearing: Hearing,
    /// Principal components of what is heard (eq. 4 and 5).
    pub speech: Linear,
    /// What chooses clusters in place of the distance of eq. 8, where the model was trained with a guide.
    pub guide: Option<Guide>,
    /// Colours of the root.
    pub colours: Colours,
    /// Reads eigenmouth weights from all appearances, so that the model can be measured beside others: rows of \[bias; c of every node\], `[1 + C, D]`.
    pub reading: Array2<f32>,
    /// The eigenmouths that it reads.
    pub mouth: MouthSpace,
    /// Where the model comes from. For people.
    pub provenance: String,
}

impl HierarchicalModel {
    /// Puts the pieces together.
    ///
    /// # Errors
    ///
    /// [`Error::Data`]: their sizes do not fit each other.
    pub fn new(pieces: Pieces) -> Result<Self> {
        let Pieces {
            tree,
            nodes,
            hearing,
            speech,
            guide,
            colours,
            reading,
            mouth,
            ..
        } = &pieces;
        let sizes_fit = std::iter::zip(nodes, &tree.areas).all(|(node, area)| {
            node.appearance.shape.size() == 2 * area.landmarks.len()
                && node.map.appearance_size() == node.appearance.size()
                && node.map.precision.len() == speech.modes()
        });
        let all: usize = nodes.iter().map(|node| node.appearance.size()).sum();
        if nodes.is_empty()
            || nodes.len() != tree.areas.len()
            || !sizes_fit
            || speech.size() != hearing.size()
            || reading.dim() != (1 + all, mouth.size())
        {
            bail!(
                Data,
                "the nodes, the speech, the eigenmouths and the tree of the model do not fit each other"
            );
        }
        if let Some(guide) = guide {
            guide.check(nodes.iter().map(|node| &node.map))?;
        }
        let root = &nodes[0].appearance;
        let half = half_patch(root)?;
        if colours.chroma.dim() != (colours.appearances.nrows(), 2 * half.len())
            || colours.appearances.ncols() != root.size()
            || colours.appearances.nrows() == 0
        {
            bail!(Data, "the colours of the model do not fit its root");
        }
        let inlays = tree
            .parents()
            .into_iter()
            .enumerate()
            .map(|(index, parent)| {
                let parent = parent?;
                let of_parent = &tree.areas[parent].landmarks;
                let places: Option<Vec<usize>> = tree.areas[index]
                    .landmarks
                    .iter()
                    .map(|k| of_parent.iter().position(|p| p == k))
                    .collect();
                let places = places?;
                let inlay = compose::Inlay::new(&nodes[parent], &nodes[index], &places);
                Some((parent, places, inlay))
            })
            .collect();
        Ok(Self { pieces, inlays })
    }

    /// Numbers of all appearances together, the root's first.
    pub fn n_parameters(&self) -> usize {
        self.nodes.iter().map(|node| node.appearance.size()).sum()
    }

    /// The numbers of each node among all: name and range.
    pub fn groups(&self) -> Vec<(&str, std::ops::Range<usize>)> {
        let mut begin = 0;
        std::iter::zip(&self.tree.areas, &self.nodes)
            .map(|(area, node)| {
                let range = begin..begin + node.appearance.size();
                begin = range.end;
                (area.name.as_str(), range)
            })
            .collect()
    }

    /// Appearances of every picture of a sound at [`speech::PICTURES_HZ`], `[pictures, C of all nodes]`, smoothed; each cluster chosen as is said.
    ///
    /// # Errors
    ///
    /// A choice that the model was not trained for; a sound that is not finite to its guide.
    pub fn convert(&self, samples: &[i16], choice: Choice) -> Result<Array2<f32>> {
        self.convert_speech(&self.hear(samples), samples, choice)
    }

    /// Speech parameters s of every picture of a sound at [`speech::PICTURES_HZ`] (eq. 5), `[pictures, S]`.
    pub fn hear(&self, samples: &[i16]) -> Array2<f32> {
        let pictures = self.hearing.pictures(samples.len());
        let heard = self
            .hearing
            .of_pictures(samples, pictures, speech::PICTURES_HZ as f32);
        self.speech_parameters(&heard)
    }

    /// [`HierarchicalModel::convert`] of a sound whose speech parameters a [`voice::Voice`] may have brought to those of the training voice; a guide hears the sound itself.
    ///
    /// # Errors
    ///
    /// As [`HierarchicalModel::convert`].
    pub fn convert_speech(
        &self,
        speech: &Array2<f32>,
        samples: &[i16],
        choice: Choice,
    ) -> Result<Array2<f32>> {
        let Some(guide) = self.guide_of(choice)? else {
            return Ok(self.convert_alone(speech));
        };
        let rate_hz = speech::PICTURES_HZ as f32;
        let evidence = guide.teacher.evidence(choice, samples, speech.nrows(), rate_hz)?;
        let parts = std::iter::zip(&self.nodes, guide.advice(choice)).map(|(node, advice)| {
            let heard = speech.outer_iter().zip(evidence.outer_iter());
            node.map
                .convert_by(speech, heard.map(|(s, e)| advice.choose(&node.map, e, s)))
        });
        Ok(smoothed(&parts.collect::<Vec<_>>()))
    }

    /// What makes a choice; none where each picture's own sound does.
    ///
    /// # Errors
    ///
    /// That the model was not trained for it.
    pub fn guide_of(&self, choice: Choice) -> Result<Option<&Guide>> {
        match &self.guide {
            _ if choice == Choice::Mahalanobis => Ok(None),
            Some(guide) if !guide.advice(choice).is_empty() => Ok(Some(guide)),
            _ => Err(guide::not_trained(choice)),
        }
    }

    /// Appearances of speech parameters `[pictures, S]`, chosen and estimated from each picture's own, smoothed.
    pub fn convert_alone(&self, speech: &Array2<f32>) -> Array2<f32> {
        let parts = self.nodes.iter().map(|node| node.map.convert(speech));
        smoothed(&parts.collect::<Vec<_>>())
    }

    /// Speech parameters s of what was heard of pictures (eq. 5).
    pub fn speech_parameters(&self, heard: &Array2<f32>) -> Array2<f32> {
        (heard - &self.speech.mean).dot(&self.speech.components.t())
    }

    /// Eigenmouth weights of appearances `[n, C]`.
    pub fn eigenmouths(&self, appearances: &Array2<f32>) -> Array2<f32> {
        appearances.dot(&self.reading.slice(s![1.., ..])) + self.reading.row(0)
    }

    /// The root with everything that its parts say, for the numbers of all nodes.
    pub fn compose(&self, appearances: ArrayView1<f32>) -> Part {
        let mut parts: Vec<Part> = std::iter::zip(&self.nodes, self.groups())
            .map(|(node, (_, range))| compose::part(node, appearances.slice(s![range])))
            .collect();
        // Children stand behind their parents: from the last to the first is from the leaves to the root.
        for index in (1..parts.len()).rev() {
            if let Some((parent, places, inlay)) = &self.inlays[index] {
                let child = parts[index].clone();
                let (of_parent, of_child) = (&self.nodes[*parent], &self.nodes[index]);
                compose::add(&mut parts[*parent], of_parent, &child, of_child, inlay, places);
            }
        }
        parts.swap_remove(0)
    }

    /// Shapes of the composed root for a row of the numbers of all nodes each, `[n, 2 × landmarks]`.
    pub fn shapes(&self, appearances: &Array2<f32>) -> Array2<f32> {
        let mut out = Array2::zeros((appearances.nrows(), self.nodes[0].appearance.shape.size()));
        for (row, mut shape) in appearances.outer_iter().zip(out.outer_iter_mut()) {
            shape.assign(&self.compose(row).shape);
        }
        out
    }

    /// The training picture whose appearance is nearest to a composed root's.
    pub fn nearest(&self, root: &Part) -> usize {
        let c = self.nodes[0]
            .appearance
            .project(root.shape.view(), root.texture.view());
        let distance =
            |row: ArrayView1<f32>| -> f32 { std::iter::zip(&row, &c).map(|(a, b)| (a - b).powi(2)).sum() };
        let distances = self.colours.appearances.outer_iter().map(distance);
        let best = distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
        best.map_or(0, |(index, _)| index)
    }

    /// Whether a file holds such a model.
    pub fn is_kind(from: &Tensors) -> bool {
        from.noted::<String>("kind").is_ok_and(|kind| kind == KIND)
    }

    /// Writes the model.
    ///
    /// # Errors
    ///
    /// That the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut out = TensorsBuilder::default();
        out.note("kind", KIND);
        out.note("hierarchical.version", VERSION);
        out.note("provenance", &self.provenance);
        out.note("hierarchical.tree", serde_json::to_string(&self.tree)?);
        self.hearing.put(&mut out);
        self.speech.put(&mut out, "speech");
        for (area, node) in std::iter::zip(&self.tree.areas, &self.nodes) {
            node.appearance
                .put(&mut out, &format!("node.{}.appearance", area.name));
            node.map.put(&mut out, &format!("node.{}.map", area.name));
        }
        if let Some(guide) = &self.guide {
            guide.put(&mut out, self.tree.areas.iter().map(|area| area.name.as_str()));
        }
        out.put("colours.appearances", &self.colours.appearances);
        out.put("colours.chroma", &self.colours.chroma);
        out.put("reading", &self.reading);
        self.mouth.store(&mut out);
        out.write(path)
    }

    /// Reads a file.
    ///
    /// # Errors
    ///
    /// That it cannot be read, holds something else, or is damaged.
    pub fn read(path: &Path) -> Result<Self> {
        let tensors = Tensors::read(path)?;
        Self::from_tensors(&tensors)
            .with_context(|| format!("{} is no usable hierarchical model", path.display()))
    }

    /// The model in a file that has been read.
    ///
    /// # Errors
    ///
    /// As [`HierarchicalModel::read`].
    pub fn from_tensors(from: &Tensors) -> Result<Self> {
        if !Self::is_kind(from) {
            return Err(Error::File("it holds a model of another kind".to_owned()));
        }
        let version: u32 = from.noted("hierarchical.version")?;
        if version != VERSION {
            bail!(
                File,
                "it is of version {version}, this program reads {VERSION}: train it again"
            );
        }
        let tree: String = from.noted("hierarchical.tree")?;
        let tree: Tree = serde_json::from_str(&tree)?;
        let most = tree.areas.first().and_then(|root| root.landmarks.iter().max());
        let tree = tree.over(most.map_or(0, |most| most + 1))?;
        let nodes = tree
            .areas
            .iter()
            .map(|area| {
                Ok(Node {
                    appearance: Appearance::read(from, &format!("node.{}.appearance", area.name))?,
                    map: SpeechMap::read(from, &format!("node.{}.map", area.name))?,
                })
            })
            .collect::<Result<_>>()?;
        Self::new(Pieces {
            nodes,
            guide: Guide::read(from, tree.areas.iter().map(|area| area.name.as_str()))?,
            tree,
            hearing: Hearing::read(from)?,
            speech: Linear::read(from, "speech")?,
            colours: Colours {
                appearances: from.array("colours.appearances")?,
                chroma: from.array("colours.chroma")?,
            },
            reading: from.array("reading")?,
            mouth: MouthSpace::load(from)?,
            provenance: from.noted("provenance")?,
        })
    }
}

/// The numbers of all nodes side by side, smoothed.
fn smoothed(parts: &[Array2<f32>]) -> Array2<f32> {
    let views: Vec<_> = parts.iter().map(|part| part.view()).collect();
    clusters::smooth(&concatenate(Axis(1), &views).expect("a row for each picture"))
}

/// The pixels of a node's mean shape at half its size.
///
/// # Errors
///
/// As [`appearance::patch`].
pub fn half_patch(node: &Appearance) -> Result<mesh::Patch> {
    appearance::patch((&node.shape.mean * 0.5).view(), &node.triangles)
}

/// Rows of pictures, `rate_hz` a second, at the 100 frames a second of everything else: linear between the pictures' middles, held beyond the first and the last.
pub fn at_frames(rows: &Array2<f32>, rate_hz: f32, frames: usize) -> Array2<f32> {
    let mut out = Array2::zeros((frames, rows.ncols()));
    if rows.nrows() == 0 {
        return out;
    }
    let last = (rows.nrows() - 1) as f64;
    for (t, mut row) in out.outer_iter_mut().enumerate() {
        let place = (time::frame_seconds(t) * f64::from(rate_hz) - 0.5).clamp(0.0, last);
        let (before, part) = (place.floor() as usize, place.fract() as f32);
        let after = (before + 1).min(rows.nrows() - 1);
        let mixed: Array1<f32> = &rows.row(before) * (1.0 - part) + &rows.row(after) * part;
        row.assign(&mixed);
    }
    out
}

#[cfg(test)]
mod tests;
