//! Pages in a browser: of `lipstream view`, and of `lipstream landmarks --page`.
//!
//! A page is for the person at this computer: its server listens on the loopback unless told otherwise, and then wants the token that its address carries. A
//! page of another origin gets nothing, whatever name it came under.
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use tokio::net::TcpListener;
use tokio::sync::oneshot;

use crate::desk::Desk;
use door::Door;

mod door;
mod label;
mod socket;
mod view;

pub use label::{Labelling, Progress, Proposal};

/// How long an answer may take to arrive when the server ends.
const FAREWELL: Duration = Duration::from_millis(200);

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

impl Server {
    /// Serves the page of `desk`.
    ///
    /// # Errors
    ///
    /// That nothing can listen there.
    pub fn start(desk: Arc<Desk>, place: &Place) -> io::Result<Self> {
        Self::serve(place, |door| view::router(desk, door))
    }

    /// Serves the page on which pictures are labelled.
    ///
    /// # Errors
    ///
    /// That nothing can listen there.
    pub fn label(labelling: impl Labelling, place: &Place) -> io::Result<Self> {
        Self::serve(place, |door| label::router(labelling, door))
    }

    fn serve(place: &Place, router: impl FnOnce(Arc<Door>) -> Router) -> io::Result<Self> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?;
        let listener = runtime.block_on(TcpListener::bind((place.address, place.port)))?;
        let address = listener.local_addr()?;
        let loopback = place.address.is_loopback();
        let token = (!loopback).then(door::token);
        let door = Arc::new(Door {
            token: token.clone(),
            loopback,
            port: address.port(),
        });
        let router = router(door);
        let (stop, stopped) = oneshot::channel::<()>();
        let thread = std::thread::spawn(move || {
            runtime.block_on(async move {
                let (closing, closed) = oneshot::channel::<()>();
                let serving = axum::serve(listener, router).with_graceful_shutdown(async {
                    let _ = stopped.await;
                    drop(closing);
                });
                // Answers on their way arrive; a watcher who stays is not waited for.
                let patience = async {
                    let _ = closed.await;
                    tokio::time::sleep(FAREWELL).await;
                };
                tokio::select! {
                    _ = serving.into_future() => {}
                    () = patience => {}
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
