//! Where events go out to everyone who watches.
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::broadcast::error::{RecvError, TryRecvError};
use tokio::sync::broadcast::{self, Receiver, Sender};

use crate::event::{Announcement, Event, Health, Notice};

/// Events that a watcher may be behind: about 10 s of frames and sound. Who is further behind has lost its place.
const BEHIND: usize = 2048;
/// Notices that somebody who comes later still reads.
const NOTICES: usize = 20;

/// Everyone who watches, and what they must know who come later.
pub struct Hub {
    sender: Sender<Event>,
    /// Also orders what is sent after what is remembered: a watcher gets every event once.
    past: Mutex<Past>,
}

#[derive(Default)]
struct Past {
    hello: Option<Event>,
    status: Option<Health>,
    notices: VecDeque<Notice>,
    end: Option<Event>,
}

/// Everything that happens, for one who watches.
pub struct Watch(Receiver<Event>);

/// Why there is no event.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Missed {
    /// The watcher was too slow: so many events are gone. What comes next is newer.
    #[error("{0} events are gone")]
    Slow(u64),
    /// Nothing will happen any more.
    #[error("nothing happens any more")]
    Over,
}

impl From<RecvError> for Missed {
    fn from(error: RecvError) -> Self {
        match error {
            RecvError::Lagged(lost) => Missed::Slow(lost),
            RecvError::Closed => Missed::Over,
        }
    }
}

impl Watch {
    /// Waits for the next event.
    ///
    /// # Errors
    ///
    /// [`Missed`].
    pub fn wait(&mut self) -> Result<Event, Missed> {
        Ok(self.0.blocking_recv()?)
    }

    /// The next event, for those who have other things to wait for.
    ///
    /// # Errors
    ///
    /// [`Missed`].
    pub async fn next(&mut self) -> Result<Event, Missed> {
        Ok(self.0.recv().await?)
    }

    /// The next event if there is one.
    ///
    /// # Errors
    ///
    /// [`Missed`].
    pub fn now(&mut self) -> Result<Option<Event>, Missed> {
        match self.0.try_recv() {
            Ok(event) => Ok(Some(event)),
            Err(TryRecvError::Empty) => Ok(None),
            Err(TryRecvError::Lagged(lost)) => Err(Missed::Slow(lost)),
            Err(TryRecvError::Closed) => Err(Missed::Over),
        }
    }
}

impl Default for Hub {
    fn default() -> Self {
        Self {
            sender: broadcast::channel(BEHIND).0,
            past: Mutex::default(),
        }
    }
}

impl Hub {
    /// Tells everyone.
    pub fn send(&self, event: Event) {
        let mut past = self.past.lock().unwrap_or_else(PoisonError::into_inner);
        match &event {
            Event::Hello(_) => {
                past.hello = Some(event.clone());
                past.end = None;
            }
            Event::Status(health) => past.status = Some(*health),
            Event::Notice(notice) => {
                past.notices.push_back(notice.clone());
                if past.notices.len() > NOTICES {
                    past.notices.pop_front();
                }
            }
            Event::End(_) => past.end = Some(event.clone()),
            Event::Frame(_) | Event::Sound(_) => {}
        }
        // That nobody watches is no error.
        let _ = self.sender.send(event);
    }

    /// What has to be known of before, and everything from now on.
    pub fn watch(&self) -> (Vec<Event>, Watch) {
        let past = self.past.lock().unwrap_or_else(PoisonError::into_inner);
        let mut before: Vec<Event> = past.notices.iter().cloned().map(Event::Notice).collect();
        before.extend(past.hello.clone());
        before.extend(past.status.map(Event::Status));
        before.extend(past.end.clone());
        (before, Watch(self.sender.subscribe()))
    }

    /// Who speaks, as far as anyone has.
    pub fn hello(&self) -> Option<Arc<Announcement>> {
        let past = self.past.lock().unwrap_or_else(PoisonError::into_inner);
        match &past.hello {
            Some(Event::Hello(said)) => Some(Arc::clone(said)),
            _ => None,
        }
    }

    /// Whether somebody speaks, and has not come to an end.
    pub fn runs(&self) -> bool {
        let past = self.past.lock().unwrap_or_else(PoisonError::into_inner);
        matches!(&past.hello, Some(Event::Hello(said)) if said.running) && past.end.is_none()
    }

    /// How many watch.
    pub fn watchers(&self) -> usize {
        self.sender.receiver_count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::event::Level;

    fn notice(text: &str) -> Event {
        Event::Notice(Notice {
            level: Level::Info,
            text: text.into(),
        })
    }

    #[test]
    fn who_comes_later_knows_what_matters() {
        let hub = Hub::default();
        for n in 0..30 {
            hub.send(notice(&n.to_string()));
        }
        hub.send(Event::Status(Health::default()));
        let (before, mut after) = hub.watch();
        assert_eq!(before.len(), NOTICES + 1);
        assert!(matches!(&before[0], Event::Notice(n) if &*n.text == "10"));
        assert!(matches!(after.now(), Ok(None)));
        hub.send(notice("new"));
        assert!(matches!(after.now(), Ok(Some(Event::Notice(_)))));
    }

    #[test]
    fn a_slow_watcher_loses_its_place_and_nobody_waits() {
        let hub = Hub::default();
        let (_, mut slow) = hub.watch();
        for _ in 0..3 * BEHIND {
            hub.send(notice("on and on"));
        }
        assert!(matches!(slow.now(), Err(Missed::Slow(_))));
        assert_eq!(hub.watchers(), 1);
    }
}
