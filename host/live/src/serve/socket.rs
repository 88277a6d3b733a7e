//! One watcher's WebSocket.
use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Query, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use lipstream::time::FRAME_RATE_HZ;
use lipstream_core::wire::{Hello, PROTOCOL};
use serde::Deserialize;
use serde_json::{Value, json};
use tokio::sync::watch;
use tokio::time::timeout;

use super::view::{Asked, Watched};
use crate::desk::Desk;
use crate::event::{Announcement, Command, Event};
use crate::face::{Face, Picture};
use crate::hub::Missed;
use crate::outputs;

/// Bytes of the longest thing that a page has to say.
const MOST: usize = 4096;
/// A client that takes nothing for so long is gone.
const PATIENCE: Duration = Duration::from_secs(5);
/// Watchers at a time.
const WATCHERS: usize = 32;
/// How long the page waits for frames that come late.
const BUFFER_MS: u32 = 40;

/// `GET /live`: everything that happens, from now on.
pub(super) async fn live(
    State(watched): State<Arc<Watched>>,
    Query(asked): Query<Asked>,
    upgrade: WebSocketUpgrade,
) -> Response {
    if !watched.door.lets_in(asked.token.as_deref()) {
        return StatusCode::UNAUTHORIZED.into_response();
    }
    if watched.desk.hub().watchers() >= WATCHERS {
        return (StatusCode::SERVICE_UNAVAILABLE, "too many watch already").into_response();
    }
    let form = match asked.form.as_deref() {
        Some("json") => Form::Json,
        _ => Form::Binary,
    };
    let desk = Arc::clone(&watched.desk);
    upgrade
        .max_message_size(MOST)
        .max_frame_size(MOST)
        .on_upgrade(move |socket| watch(socket, desk, form))
}

/// How frames and sound are written.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Form {
    Binary,
    Json,
}

async fn watch(mut socket: WebSocket, desk: Arc<Desk>, form: Form) {
    let (before, mut events) = desk.hub().watch();
    let mut recording = desk.recording();
    for event in before {
        if let Some(message) = message(&event, &desk, form)
            && !send(&mut socket, message).await
        {
            return;
        }
    }
    if !desk.has_source()
        && let Some(nobody) = idle(&desk)
        && !send(&mut socket, text(&nobody)).await
    {
        return;
    }
    let mut gallery = Gallery::default();
    loop {
        tokio::select! {
            event = events.next() => {
                let event = match event {
                    Ok(event) => event,
                    Err(Missed::Slow(_)) => {
                        // It would see frames of long ago; it can come again.
                        let _ = timeout(PATIENCE, socket.send(Message::Close(Some(CloseFrame {
                            code: 1008,
                            reason: "too slow".into(),
                        })))).await;
                        return;
                    }
                    Err(Missed::Over) => return,
                };
                if desk.recording() != recording {
                    recording = desk.recording();
                    let said = text(&json!({ "type": "recording", "name": recording }));
                    if !send(&mut socket, said).await {
                        return;
                    }
                }
                if let Some(message) = message(&event, &desk, form)
                    && !send(&mut socket, message).await
                {
                    return;
                }
            }
            picture = gallery.next(), if gallery.has_room() => {
                if !send(&mut socket, picture_message(&picture)).await {
                    return;
                }
            }
            asked = socket.recv() => {
                let Some(Ok(asked)) = asked else { return };
                if let Message::Text(words) = asked
                    && let Some(answer) = obey(&words, &desk, &mut gallery)
                    && !send(&mut socket, text(&answer)).await
                {
                    return;
                }
            }
        }
    }
}

/// Pictures that a page has been sent and not seen: one on its way, one being unpacked, one that waits for its time.
const UNSEEN: u32 = 3;

/// A face's pictures for one page. What it has not said to have seen bounds what lies on the line before its frames and its sound.
#[derive(Default)]
struct Gallery {
    pictures: Option<watch::Receiver<Option<Arc<Picture>>>>,
    unseen: u32,
}

impl Gallery {
    /// Begins or ends to show the face of the model that speaks.
    fn open(&mut self, desk: &Desk, on: bool) {
        let model = desk.hub().hello().map(|said| said.hello.model);
        self.unseen = 0;
        self.pictures = match model.filter(|_| on) {
            Some(model) => desk.face(model).map(Face::watch),
            None => None,
        };
    }

    fn seen(&mut self) {
        self.unseen = self.unseen.saturating_sub(1);
    }

    fn has_room(&self) -> bool {
        self.pictures.is_some() && self.unseen < UNSEEN
    }

    /// Waits for a picture that is newer than the last; without a face for ever.
    async fn next(&mut self) -> Arc<Picture> {
        if let Some(pictures) = &mut self.pictures {
            while pictures.changed().await.is_ok() {
                let newest = pictures.borrow_and_update().clone();
                if let Some(picture) = newest {
                    self.unseen += 1;
                    return picture;
                }
            }
        }
        std::future::pending().await
    }
}

/// A picture of a face as bytes.
fn picture_message(picture: &Picture) -> Message {
    let head = Head {
        kind: 3,
        visemes: 0,
        count: 0,
        // Numbers that wrap are told apart by their samples.
        sequence: picture.number as u32,
        sample: picture.sample,
        arrived_ms: picture.arrived_ms,
        heard_ms: picture.heard_ms.unwrap_or(f64::NAN),
    };
    let mut bytes = head.bytes();
    bytes.extend(&picture.jpeg);
    Message::Binary(bytes.into())
}

/// Sends, if the client takes it in time.
async fn send(socket: &mut WebSocket, message: Message) -> bool {
    matches!(timeout(PATIENCE, socket.send(message)).await, Ok(Ok(())))
}

fn text(value: &Value) -> Message {
    Message::Text(value.to_string().into())
}

/// An event as the client wants it.
fn message(event: &Event, desk: &Desk, form: Form) -> Option<Message> {
    match (event, form) {
        (Event::Frame(timed), Form::Binary) => {
            let visemes = &timed.frame.viseme_weights;
            let parameters = timed.parameters();
            let head = Head {
                kind: 1,
                visemes: visemes.len() as u8,
                count: parameters.len() as u16,
                sequence: timed.frame.sequence,
                sample: timed.sample as f64,
                arrived_ms: timed.arrived_ms,
                heard_ms: timed.heard_ms.unwrap_or(f64::NAN),
            };
            let mut bytes = head.bytes();
            for parameter in parameters {
                bytes.extend(parameter.to_le_bytes());
            }
            bytes.extend(visemes);
            Some(Message::Binary(bytes.into()))
        }
        (Event::Sound(sound), Form::Binary) => {
            let head = Head {
                kind: 2,
                visemes: 0,
                count: sound.samples.len() as u16,
                sequence: 0,
                sample: sound.sample as f64,
                arrived_ms: sound.heard_ms,
                heard_ms: sound.heard_ms,
            };
            let mut bytes = head.bytes();
            for sample in &sound.samples {
                bytes.extend(sample.to_le_bytes());
            }
            Some(Message::Binary(bytes.into()))
        }
        (Event::Hello(said), _) => hello(event, desk, said.hello.model).as_ref().map(text),
        (Event::Status(_), _) => {
            let mut value = outputs::json(event)?;
            value["clients"] = desk.hub().watchers().into();
            value["recording"] = desk.recording().into();
            value["running"] = desk.hub().runs().into();
            Some(text(&value))
        }
        _ => outputs::json(event).as_ref().map(text),
    }
}

/// Who speaks, and what a page has to know besides what the device says.
fn hello(said: &Event, desk: &Desk, model: u32) -> Option<Value> {
    let mut value = outputs::json(said)?;
    value["mouth"] = desk.draws(model).into();
    value["face"] = match desk.face(model) {
        Some(face) => json!({ "width": face.size().0, "height": face.size().1, "fps": face.fps() }),
        None => Value::Null,
    };
    value["can"] = desk.can().into();
    value["buffer_ms"] = BUFFER_MS.into();
    value["recording"] = desk.recording().into();
    Some(value)
}

/// What a page hears where nothing is attached.
fn idle(desk: &Desk) -> Option<Value> {
    let nobody = Event::Hello(Arc::new(Announcement {
        source: "nothing is attached".to_owned(),
        hello: Hello {
            protocol: PROTOCOL,
            model: 0,
            rate_hz: FRAME_RATE_HZ as u16,
            lag_samples: 0,
            visemes: 0,
            groups: Default::default(),
            scales: Default::default(),
        },
        profile: None,
        sound: false,
        running: false,
        opening: None,
    }));
    let mut value = hello(&nobody, desk, 0)?;
    value["model"] = "none".into();
    Some(value)
}

/// The head of what goes out as bytes: 32 of them, low byte first.
struct Head {
    kind: u8,
    visemes: u8,
    count: u16,
    sequence: u32,
    sample: f64,
    arrived_ms: f64,
    heard_ms: f64,
}

impl Head {
    fn bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(32 + 4 * usize::from(self.count) + usize::from(self.visemes));
        bytes.extend([self.kind, self.visemes]);
        bytes.extend(self.count.to_le_bytes());
        bytes.extend(self.sequence.to_le_bytes());
        bytes.extend(self.sample.to_le_bytes());
        bytes.extend(self.arrived_ms.to_le_bytes());
        bytes.extend(self.heard_ms.to_le_bytes());
        bytes
    }
}

/// What a page asks for.
#[derive(Deserialize)]
#[serde(tag = "type", rename_all = "lowercase")]
enum Words {
    Ping {
        t: f64,
    },
    Start,
    Stop,
    Demo,
    Profile {
        profile: String,
    },
    Record {
        on: bool,
    },
    /// Pictures of the face are wanted, or not any more.
    Face {
        on: bool,
    },
    /// A picture of the face has been taken.
    Seen,
}

/// Does what a page asks for; words that are none are passed over.
fn obey(words: &str, desk: &Desk, gallery: &mut Gallery) -> Option<Value> {
    match serde_json::from_str(words).ok()? {
        Words::Ping { t } => return Some(json!({ "type": "pong", "t": t, "now_ms": desk.clock().now_ms() })),
        Words::Start => desk.command(Command::Start),
        Words::Stop => desk.command(Command::Stop),
        Words::Profile { profile } => desk.command(Command::Profile(outputs::profile_of(&profile)?)),
        Words::Record { on } => desk.record(on),
        Words::Demo => desk.demo(),
        Words::Face { on } => gallery.open(desk, on),
        Words::Seen => gallery.seen(),
    }
    None
}
