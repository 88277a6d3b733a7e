//! The page: what it is made of over HTTP, and what happens over a WebSocket (`docs/live.md`).
//!
//! It is for the person at this computer: it listens on the loopback unless told otherwise, and then wants the token that its address carries. A
//! page of another origin gets nothing, whatever name it came under.
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;

use axum::Router;
use axum::body::Body;
use axum::extract::{Query, Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use serde::Deserialize;
use tokio::net::TcpListener;
use tokio::sync::oneshot;

use crate::desk::Desk;

mod socket;

/// Files of the page: name, kind, content.
const FILES: &[(&str, &str, &str)] = &[
    ("/", "text/html; charset=utf-8", include_str!("page/page.html")),
    (
        "/style.css",
        "text/css; charset=utf-8",
        include_str!("page/style.css"),
    ),
    ("/icon.svg", "image/svg+xml", include_str!("page/icon.svg")),
    ("/app.js", SCRIPT, include_str!("page/app.js")),
    ("/clock.js", SCRIPT, include_str!("page/clock.js")),
    ("/face.js", SCRIPT, include_str!("page/face.js")),
    ("/link.js", SCRIPT, include_str!("page/link.js")),
    ("/mouth.js", SCRIPT, include_str!("page/mouth.js")),
    ("/plots.js", SCRIPT, include_str!("page/plots.js")),
    ("/sound.js", SCRIPT, include_str!("page/sound.js")),
];
const SCRIPT: &str = "text/javascript; charset=utf-8";
/// What the page may load: itself.
const POLICY: &str = "default-src 'self'; connect-src 'self'; frame-ancestors 'none'";

/// Where to listen.
#[derive(Clone, Debug)]
pub struct Place {
    /// The loopback, or an address of this computer that others reach.
    pub address: IpAddr,
    /// The port; 0 takes any that is free.
    pub port: u16,
}

/// A page that is being served; it ends when this value is dropped.
pub struct Server {
    address: SocketAddr,
    token: Option<String>,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

/// What every request is held against.
struct Door {
    desk: Arc<Desk>,
    token: Option<String>,
    loopback: bool,
    port: u16,
}

impl Server {
    /// Serves the page of `desk`.
    ///
    /// # Errors
    ///
    /// That nothing can listen there.
    pub fn start(desk: Arc<Desk>, place: &Place) -> io::Result<Self> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?;
        let listener = runtime.block_on(TcpListener::bind((place.address, place.port)))?;
        let address = listener.local_addr()?;
        let loopback = place.address.is_loopback();
        let token = (!loopback).then(token);
        let door = Arc::new(Door {
            desk,
            token: token.clone(),
            loopback,
            port: address.port(),
        });
        let (stop, stopped) = oneshot::channel::<()>();
        let thread = std::thread::spawn(move || {
            runtime.block_on(async move {
                let serving = axum::serve(listener, router(door)).into_future();
                tokio::select! {
                    _ = serving => {}
                    _ = stopped => {}
                }
            });
            // Clients that are still connected are dropped.
            runtime.shutdown_background();
        });
        Ok(Self {
            address,
            token,
            stop: Some(stop),
            thread: Some(thread),
        })
    }

    /// What a browser is given.
    pub fn url(&self) -> String {
        match &self.token {
            Some(token) => format!("http://{}/?token={token}", self.address),
            None => format!("http://{}/", self.address),
        }
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.take();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// 128 bits that nobody guesses, from the system.
fn token() -> String {
    use std::hash::{BuildHasher, Hasher, RandomState};
    // The standard library seeds every `RandomState` from the system's source of random numbers.
    (0..2)
        .map(|_| format!("{:016x}", RandomState::new().build_hasher().finish()))
        .collect()
}

fn router(door: Arc<Door>) -> Router {
    let mut router = Router::new()
        .route("/mouth", get(mouth))
        .route("/live", get(socket::live));
    for &(name, kind, content) in FILES {
        router = router.route(
            name,
            get(move || async move { ([(header::CONTENT_TYPE, kind)], content) }),
        );
    }
    router
        .layer(middleware::from_fn_with_state(Arc::clone(&door), guard))
        .with_state(door)
}

/// Refuses whoever came under another name, and marks what goes out.
async fn guard(State(door): State<Arc<Door>>, request: Request, next: Next) -> Response {
    if let Err(why) = door.check(request.headers()) {
        return (StatusCode::FORBIDDEN, why).into_response();
    }
    let mut response = next.run(request).await;
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY));
    headers.insert(
        header::X_CONTENT_TYPE_OPTIONS,
        HeaderValue::from_static("nosniff"),
    );
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    response
}

impl Door {
    /// The name in the request must be this computer's own, and a page that asks must be ours.
    fn check(&self, headers: &HeaderMap) -> Result<(), &'static str> {
        let text = |name| headers.get(name).and_then(|value| value.to_str().ok());
        let host = text(header::HOST).unwrap_or_default();
        if self.loopback {
            let names = ["127.0.0.1", "localhost", "[::1]"];
            let ours = names.iter().any(|name| host == format!("{name}:{}", self.port));
            if !ours {
                return Err("open the page under the address that lipstream printed");
            }
        }
        match text(header::ORIGIN) {
            Some(origin) if origin != format!("http://{host}") => Err("this page is for itself only"),
            _ => Ok(()),
        }
    }

    /// Whether a request may see what the device says.
    fn lets_in(&self, given: Option<&str>) -> bool {
        self.token.is_none() || self.token.as_deref() == given
    }
}

/// What an address may carry behind its question mark.
#[derive(Deserialize)]
struct Asked {
    token: Option<String>,
    /// `json` for everything in text; else frames and sound come as bytes.
    #[serde(rename = "as")]
    form: Option<String>,
}

/// The eigenmouths of the model that speaks.
async fn mouth(State(door): State<Arc<Door>>, Query(asked): Query<Asked>) -> Response {
    if !door.lets_in(asked.token.as_deref()) {
        return StatusCode::UNAUTHORIZED.into_response();
    }
    match door.desk.mouth() {
        Some(bytes) => (
            [(header::CONTENT_TYPE, "application/octet-stream")],
            Body::from(bytes.as_ref().clone()),
        )
            .into_response(),
        None => StatusCode::NOT_FOUND.into_response(),
    }
}
