//! The page of `lipstream view`: what it is made of over HTTP, and what happens over a WebSocket (`docs/live.md`).
use std::sync::Arc;

use axum::Router;
use axum::body::Body;
use axum::extract::{Query, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use serde::Deserialize;

use super::door::{self, Door, File, PAGE, SCRIPT};
use super::socket;
use crate::desk::Desk;

/// Files of the page.
const FILES: &[File] = &[
    ("/", PAGE, include_str!("page/page.html")),
    ("/app.js", SCRIPT, include_str!("page/app.js")),
    ("/clock.js", SCRIPT, include_str!("page/clock.js")),
    ("/face.js", SCRIPT, include_str!("page/face.js")),
    ("/link.js", SCRIPT, include_str!("page/link.js")),
    ("/mouth.js", SCRIPT, include_str!("page/mouth.js")),
    ("/plots.js", SCRIPT, include_str!("page/plots.js")),
    ("/sound.js", SCRIPT, include_str!("page/sound.js")),
];

/// The desk that is watched, and who may watch it.
pub(super) struct Watched {
    pub(super) desk: Arc<Desk>,
    pub(super) door: Arc<Door>,
}

/// What answers at the page's address.
pub(super) fn router(desk: Arc<Desk>, door: Arc<Door>) -> Router {
    let watched = Arc::new(Watched {
        desk,
        door: Arc::clone(&door),
    });
    let router = Router::new()
        .route("/mouth", get(mouth))
        .route("/live", get(socket::live))
        .with_state(watched);
    door::behind(door, router, FILES)
}

/// What an address may carry behind its question mark.
#[derive(Deserialize)]
pub(super) struct Asked {
    pub(super) token: Option<String>,
    /// `json` for everything in text; else frames and sound come as bytes.
    #[serde(rename = "as")]
    pub(super) form: Option<String>,
}

/// The eigenmouths of the model that speaks.
async fn mouth(State(watched): State<Arc<Watched>>, Query(asked): Query<Asked>) -> Response {
    if !watched.door.lets_in(asked.token.as_deref()) {
        return StatusCode::UNAUTHORIZED.into_response();
    }
    match watched.desk.mouth() {
        Some(bytes) => (
            [(header::CONTENT_TYPE, "application/octet-stream")],
            Body::from(bytes.as_ref().clone()),
        )
            .into_response(),
        None => StatusCode::NOT_FOUND.into_response(),
    }
}
