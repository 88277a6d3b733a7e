//! One system as the report sees it: something that hears a clip and says what the mouth does.
use crate::error::{Result, bail, ensure};
use ndarray::Array2;

/// What a candidate hears of one clip. The features belong to the samples, also where noise was added to
/// them or their beginning was cut off.
pub struct Heard<'a> {
    /// Name of the clip in its feature folder.
    pub id: &'a str,
    /// 16 kHz mono.
    pub samples: Vec<i16>,
    /// `[frames, 39]` of the float front end, causally normalised from the folder's start mean.
    pub observations: Array2<f32>,
}

/// What a candidate says.
#[derive(Clone, Debug, Default)]
pub struct Prediction {
    /// `[frames, D]` at 100 Hz, in the units of the folder's visual features. Up to five frames may lack at the end.
    pub parameters: Array2<f32>,
    /// Weight of each viseme, `[frames, 13]`.
    pub visemes: Option<Array2<f32>>,
}

/// The estimate after one iteration of a conversion (X&L figure 10).
#[derive(Clone, Debug)]
pub struct Iteration {
    /// `[frames, D]`.
    pub parameters: Array2<f32>,
    /// Log likelihood of the whole clip, natural.
    pub log_likelihood: f64,
}

type Predict<'a> = Box<dyn Fn(&Heard) -> Result<Prediction> + Sync + 'a>;
type Iterate<'a> = Box<dyn Fn(&Heard) -> Result<Vec<Iteration>> + Sync + 'a>;

/// One system.
pub struct Candidate<'a> {
    /// Unique in a report.
    pub name: String,
    /// Future that it looks at, in ms between frame centres; `None`: the whole utterance.
    pub look_ahead_ms: Option<u32>,
    /// Candidates of one family make one curve of quality against look-ahead.
    pub family: Option<String>,
    /// False for one that is there only as a point of its family's curve.
    pub listed: bool,
    /// False for one that knows the folder's clips by name and cannot hear anything else (predictions from files).
    pub hears: bool,
    /// Says what the mouth does in a clip that is heard.
    pub predict: Predict<'a>,
    /// Estimates from the first (before any iteration) to the last.
    pub iterations: Option<Iterate<'a>>,
}

impl<'a> Candidate<'a> {
    /// A listed system without a family that hears any sound and does not iterate.
    pub fn new(
        name: impl Into<String>,
        look_ahead_ms: Option<u32>,
        predict: impl Fn(&Heard) -> Result<Prediction> + Sync + 'a,
    ) -> Self {
        Self {
            name: name.into(),
            look_ahead_ms,
            family: None,
            listed: true,
            hears: true,
            predict: Box::new(predict),
            iterations: None,
        }
    }

    /// A point of this family's curve too.
    pub fn of_family(mut self, family: impl Into<String>) -> Self {
        self.family = Some(family.into());
        self
    }

    /// Only a point of its family's curve.
    pub fn unlisted(mut self) -> Self {
        self.listed = false;
        self
    }

    /// Gives the estimates after each iteration too, for the report's figure of convergence.
    pub fn with_iterations(
        mut self,
        iterations: impl Fn(&Heard) -> Result<Vec<Iteration>> + Sync + 'a,
    ) -> Self {
        self.iterations = Some(Box::new(iterations));
        self
    }

    /// Predicts and checks the shape against the truth's, `(frames, D)`.
    pub(super) fn say(&self, heard: &Heard, shape: (usize, usize)) -> Result<Prediction> {
        let said = (self.predict)(heard)?;
        self.check(heard.id, &said.parameters, shape)?;
        if let Some(visemes) = &said.visemes {
            ensure!(
                visemes.nrows() == said.parameters.nrows(),
                Data,
                "{}: clip {} has {} frames of visemes and {} of the mouth",
                self.name,
                heard.id,
                visemes.nrows(),
                said.parameters.nrows()
            );
        }
        Ok(said)
    }

    /// Refuses a prediction of another size than the truth, or with numbers that are none.
    pub(super) fn check(&self, id: &str, said: &Array2<f32>, shape: (usize, usize)) -> Result<()> {
        if said.ncols() != shape.1 || said.nrows().abs_diff(shape.0) > MISSING_FRAMES {
            bail!(
                Data,
                "{}: clip {id} has {:?} mouth parameters, its video has {shape:?}",
                self.name,
                said.dim()
            );
        }
        ensure!(
            said.iter().all(|v| v.is_finite()),
            Data,
            "{}: a mouth parameter of clip {id} is not finite",
            self.name
        );
        Ok(())
    }
}

/// Frames by which a prediction and the truth may differ in length: the window's two and a smoother's.
const MISSING_FRAMES: usize = 5;
