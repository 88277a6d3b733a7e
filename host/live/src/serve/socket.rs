//! One watcher's WebSocket.
use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Query, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use lipstream_core::wire::Profile;
use serde::Deserialize;
use serde_json::{Value, json};
use tokio::time::timeout;

use super::{Asked, Door};
use crate::desk::Desk;
use crate::event::{Command, Event};
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
    State(door): State<Arc<Door>>,
    Query(asked): Query<Asked>,
    upgrade: WebSocketUpgrade,
) -> Response {
    if !door.lets_in(asked.token.as_deref()) {
        return StatusCode::UNAUTHORIZED.into_response();
    }
    if door.desk.hub().watchers() >= WATCHERS {
        return (StatusCode::SERVICE_UNAVAILABLE, "too many watch already").into_response();
    }
    let form = match asked.form.as_deref() {
        Some("json") => Form::Json,
        _ => Form::Binary,
    };
    let desk = Arc::clone(&door.desk);
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
    if !desk.has_source() && !send(&mut socket, text(&idle(&desk))).await {
        return;
    }
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
            asked = socket.recv() => {
                let Some(Ok(asked)) = asked else { return };
                if let Message::Text(words) = asked
                    && let Some(answer) = obey(&words, &desk)
                    && !send(&mut socket, text(&answer)).await
                {
                    return;
                }
            }
        }
    }
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
                sample: timed.sample,
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
                sample: sound.sample,
                arrived_ms: sound.heard_ms,
                heard_ms: sound.heard_ms,
            };
            let mut bytes = head.bytes();
            for sample in &sound.samples {
                bytes.extend(sample.to_le_bytes());
            }
            Some(Message::Binary(bytes.into()))
        }
        (Event::Hello(said), _) => {
            let mut value = outputs::json(event)?;
            let known = desk.draws(said.hello.model);
            if let Value::Object(fields) = &mut value {
                fields.insert("mouth".to_owned(), known.into());
                fields.extend(about(desk));
            }
            Some(text(&value))
        }
        (Event::Status(_), _) => {
            let mut value = outputs::json(event)?;
            if let Value::Object(fields) = &mut value {
                fields.insert("clients".to_owned(), desk.hub().watchers().into());
                fields.insert("recording".to_owned(), desk.recording().into());
                fields.insert("running".to_owned(), desk.hub().runs().into());
            }
            Some(text(&value))
        }
        _ => outputs::json(event).as_ref().map(text),
    }
}

/// What a page has to know besides what the device says.
fn about(desk: &Desk) -> serde_json::Map<String, Value> {
    let value = json!({
        "can": desk.can(),
        "buffer_ms": BUFFER_MS,
        "recording": desk.recording(),
    });
    match value {
        Value::Object(fields) => fields,
        _ => serde_json::Map::new(),
    }
}

/// What a page hears where nothing is attached.
fn idle(desk: &Desk) -> Value {
    let mut value = json!({
        "type": "hello",
        "protocol": 1,
        "source": "nothing is attached",
        "model": "none",
        "rate_hz": 100,
        "sample_rate_hz": lipstream_core::SAMPLE_RATE_HZ,
        "lag_samples": 0,
        "groups": [],
        "visemes": [],
        "sound": false,
        "profile": null,
        "running": false,
        "mouth": false,
    });
    if let Value::Object(fields) = &mut value {
        fields.extend(about(desk));
    }
    value
}

/// The head of what goes out as bytes: 32 of them, low byte first.
struct Head {
    kind: u8,
    visemes: u8,
    count: u16,
    sequence: u32,
    sample: u64,
    arrived_ms: f64,
    heard_ms: f64,
}

impl Head {
    fn bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(32 + 4 * usize::from(self.count) + usize::from(self.visemes));
        bytes.extend([self.kind, self.visemes]);
        bytes.extend(self.count.to_le_bytes());
        bytes.extend(self.sequence.to_le_bytes());
        bytes.extend((self.sample as f64).to_le_bytes());
        bytes.extend(self.arrived_ms.to_le_bytes());
        bytes.extend(self.heard_ms.to_le_bytes());
        bytes
    }
}

/// What a page asks for.
#[derive(Deserialize)]
#[serde(tag = "type", rename_all = "lowercase")]
enum Words {
    Ping { t: f64 },
    Start,
    Stop,
    Demo,
    Profile { profile: Which },
    Record { on: bool },
}

#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum Which {
    Live,
    Standard,
    Studio,
}

/// Does what a page asks for; words that are none are passed over.
fn obey(words: &str, desk: &Desk) -> Option<Value> {
    match serde_json::from_str(words).ok()? {
        Words::Ping { t } => return Some(json!({ "type": "pong", "t": t, "now_ms": desk.clock().now_ms() })),
        Words::Start => desk.command(Command::Start),
        Words::Stop => desk.command(Command::Stop),
        Words::Profile { profile } => desk.command(Command::Profile(match profile {
            Which::Live => Profile::Live,
            Which::Standard => Profile::Standard,
            Which::Studio => Profile::Studio,
        })),
        Words::Record { on } => desk.record(on),
        Words::Demo => desk.demo(),
    }
    None
}
