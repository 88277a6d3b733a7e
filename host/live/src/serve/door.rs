//! Who may ask a page's server, and the files that a page is made of.
use std::sync::Arc;

use axum::Router;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;

/// The kind of the scripts among a page's files.
pub(super) const SCRIPT: &str = "text/javascript; charset=utf-8";
/// The kind of the style sheets.
pub(super) const STYLE: &str = "text/css; charset=utf-8";
/// The kind of the page itself.
pub(super) const PAGE: &str = "text/html; charset=utf-8";
/// What a page may load: what comes from where it came from.
const POLICY: &str = "default-src 'self'; connect-src 'self'; frame-ancestors 'none'";

/// A file of a page: path, kind, content.
pub(super) type File = (&'static str, &'static str, &'static str);

/// The files that every page has: the style and the icon.
pub(super) const COMMON: &[File] = &[
    ("/style.css", STYLE, include_str!("page/style.css")),
    ("/icon.svg", "image/svg+xml", include_str!("page/icon.svg")),
];

/// What every request is held against.
pub(super) struct Door {
    pub(super) token: Option<String>,
    pub(super) loopback: bool,
    pub(super) port: u16,
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
    pub(super) fn lets_in(&self, given: Option<&str>) -> bool {
        self.token.is_none() || self.token.as_deref() == given
    }
}

/// What answers at a page's address: `router` with the page's `files`, behind the door.
pub(super) fn behind(door: Arc<Door>, mut router: Router, files: &'static [File]) -> Router {
    for &(path, kind, content) in COMMON.iter().chain(files) {
        router = router.route(
            path,
            get(move || async move { ([(header::CONTENT_TYPE, kind)], content) }),
        );
    }
    router.layer(middleware::from_fn_with_state(door, guard))
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

/// 128 bits that nobody guesses, from the system.
pub(super) fn token() -> String {
    use std::hash::{BuildHasher, Hasher, RandomState};
    // The standard library seeds every `RandomState` from the system's source of random numbers.
    (0..2)
        .map(|_| format!("{:016x}", RandomState::new().build_hasher().finish()))
        .collect()
}
