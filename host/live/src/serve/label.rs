//! The page of `lipstream landmarks --page`: a picture with the points that were found in it, which a person drags to where they belong.
//!
//! | request | does | answers |
//! |---|---|---|
//! | `GET /state` | | the state, as JSON: [`Progress`] and, as `proposal`, what is to be looked at, or null |
//! | `GET /picture?clip=…&picture=…` | | the proposal's picture, JPEG |
//! | `POST /accept` `{"clip": …, "picture": …, "points": [[x, y], …]}` | keeps these points and learns anew | the state |
//! | `POST /skip` `{"clip": …, "picture": …}` | leaves this picture out | the state |
//! | `POST /done` | writes what was found | the state |
//!
//! What cannot be done is answered by a status from 400 on and a line that says why.
use std::sync::{Arc, Mutex, PoisonError};

use axum::Router;
use axum::body::Bytes;
use axum::extract::{Query, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::door::{self, Door, File, PAGE, SCRIPT, STYLE};

/// Files of the page.
const FILES: &[File] = &[
    ("/", PAGE, include_str!("page/label.html")),
    ("/label.css", STYLE, include_str!("page/label.css")),
    ("/label.js", SCRIPT, include_str!("page/label.js")),
];

/// A picture that is to be looked at.
#[derive(Clone, Debug, Serialize)]
pub struct Proposal {
    /// The clip.
    pub clip: String,
    /// Its picture, counted from 0.
    pub picture: usize,
    /// Pixels of the video, across and down.
    pub size: [usize; 2],
    /// x and y in pixels of the video, whose pixels have their centres at whole numbers.
    pub points: Vec<[f32; 2]>,
    /// Names of runs of points that belong together, and how many points each has; none where there are no runs.
    pub groups: Vec<(String, usize)>,
    /// How sure the points are, from 0 to 1; 0 where no face was found, and the points are those of a picture that is near.
    pub confidence: f32,
    /// The picture, of the same shape as `size`, but perhaps smaller.
    #[serde(skip)]
    pub jpeg: Bytes,
}

/// How far the labelling is.
#[derive(Clone, Debug, Serialize)]
pub struct Progress {
    /// Pictures that are labelled.
    pub labelled: usize,
    /// Pictures that there are.
    pub pictures: usize,
    /// Pictures whose points are unsure.
    pub unsure: usize,
    /// Pictures without a face.
    pub lost: usize,
    /// Median distance that may be expected of a point, in shares of the face's width; None while nothing says it.
    pub expected: Option<f32>,
    /// The file that has the labels.
    pub labels: String,
    /// The file that will have the points of all pictures.
    pub output: String,
    /// Whether that file is written.
    pub done: bool,
}

/// What the page asks of whoever labels. Errors are lines for the person before it.
pub trait Labelling: Send + 'static {
    /// How far it is.
    fn progress(&self) -> Progress;
    /// What is to be looked at next, None when there is nothing left.
    fn proposal(&self) -> Option<Proposal>;
    /// Keeps these points of the picture that is proposed, learns anew, and proposes another.
    ///
    /// # Errors
    ///
    /// Why these cannot be its points, or what failed.
    fn accept(&mut self, points: &[[f32; 2]]) -> Result<(), String>;
    /// Leaves out the picture that is proposed, and proposes another.
    ///
    /// # Errors
    ///
    /// What failed.
    fn skip(&mut self) -> Result<(), String>;
    /// Writes the points of all pictures.
    ///
    /// # Errors
    ///
    /// What failed.
    fn done(&mut self) -> Result<(), String>;
}

/// Whoever labels, one request at a time.
type Shared = Arc<Mutex<Box<dyn Labelling>>>;

/// What answers at the page's address.
pub(super) fn router(labelling: impl Labelling, door: Arc<Door>) -> Router {
    let shared: Shared = Arc::new(Mutex::new(Box::new(labelling)));
    let router = Router::new()
        .route("/state", get(state))
        .route("/picture", get(picture))
        .route("/accept", post(accept))
        .route("/skip", post(skip))
        .route("/done", post(done))
        .with_state(shared);
    door::behind(door, router, FILES)
}

/// A picture's name.
#[derive(Deserialize)]
struct Which {
    clip: String,
    picture: usize,
}

/// A picture's name and where its points belong.
#[derive(Deserialize)]
struct Corrected {
    #[serde(flatten)]
    which: Which,
    points: Vec<[f32; 2]>,
}

type Refusal = (StatusCode, String);

fn refusal(why: String) -> Refusal {
    (StatusCode::BAD_REQUEST, why)
}

/// Does something with whoever labels, on a thread that may take its time.
async fn with<T: Send + 'static>(
    shared: Shared,
    act: impl FnOnce(&mut dyn Labelling) -> Result<T, Refusal> + Send + 'static,
) -> Result<T, Refusal> {
    let acting = tokio::task::spawn_blocking(move || {
        let mut labelling = shared.lock().unwrap_or_else(PoisonError::into_inner);
        act(labelling.as_mut())
    });
    acting.await.unwrap_or_else(|error| {
        let why = format!("lipstream failed: {error}; what was accepted is kept");
        Err((StatusCode::INTERNAL_SERVER_ERROR, why))
    })
}

/// The state, after something was done.
async fn after(
    shared: Shared,
    act: impl FnOnce(&mut dyn Labelling) -> Result<(), Refusal> + Send + 'static,
) -> Result<Response, Refusal> {
    #[derive(Serialize)]
    struct Said {
        #[serde(flatten)]
        progress: Progress,
        proposal: Option<Proposal>,
    }
    let said = with(shared, |labelling| {
        act(labelling)?;
        let said = Said {
            progress: labelling.progress(),
            proposal: labelling.proposal(),
        };
        serde_json::to_string(&said).map_err(|error| refusal(error.to_string()))
    });
    Ok(([(header::CONTENT_TYPE, "application/json")], said.await?).into_response())
}

/// What a request's body says.
fn read<T: DeserializeOwned>(body: &[u8]) -> Result<T, Refusal> {
    serde_json::from_slice(body).map_err(|error| refusal(format!("this is not what the page sends: {error}")))
}

/// The proposal, where it is the one that is spoken of: another page may have dealt with that already.
fn asked_for(labelling: &dyn Labelling, which: &Which) -> Result<Proposal, Refusal> {
    let now = labelling.proposal();
    now.filter(|now| (&now.clip, now.picture) == (&which.clip, which.picture))
        .ok_or_else(|| {
            let why = format!(
                "picture {} of {} is not asked for any more: load the page again",
                which.picture, which.clip
            );
            (StatusCode::CONFLICT, why)
        })
}

async fn state(State(shared): State<Shared>) -> Result<Response, Refusal> {
    after(shared, |_| Ok(())).await
}

async fn picture(State(shared): State<Shared>, Query(which): Query<Which>) -> Result<Response, Refusal> {
    let proposal = with(shared, move |labelling| asked_for(labelling, &which)).await?;
    Ok(([(header::CONTENT_TYPE, "image/jpeg")], proposal.jpeg).into_response())
}

async fn accept(State(shared): State<Shared>, body: Bytes) -> Result<Response, Refusal> {
    let Corrected { which, points } = read(&body)?;
    after(shared, move |labelling| {
        asked_for(labelling, &which)?;
        labelling.accept(&points).map_err(refusal)
    })
    .await
}

async fn skip(State(shared): State<Shared>, body: Bytes) -> Result<Response, Refusal> {
    let which: Which = read(&body)?;
    after(shared, move |labelling| {
        asked_for(labelling, &which)?;
        labelling.skip().map_err(refusal)
    })
    .await
}

async fn done(State(shared): State<Shared>) -> Result<Response, Refusal> {
    after(shared, |labelling| labelling.done().map_err(refusal)).await
}
