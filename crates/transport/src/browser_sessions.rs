//! Browser sessions. A random session id in a cookie replaces the token and opens pages, but no
//! calls, for some hours. Sessions live in memory only: after a restart of the server, users log in
//! again.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use rustix::rand::{GetRandomFlags, getrandom};
use sha2::{Digest, Sha256};
use tokio::time::Instant;
use tonic::codegen::http::HeaderMap;

use crate::browser::SessionCookie;

/// Lifetime of a session, regardless of its use: a working day.
pub const SESSION_LIFETIME: Duration = Duration::from_secs(12 * 3600);
/// Most concurrent sessions. A further log-in ends the oldest session.
pub const MAX_SESSIONS: usize = 1_024;
const SESSION_ID_BYTES: usize = 16;

/// The open sessions of a server's browsers, and the cookie that holds their ids.
#[derive(Clone, Debug)]
pub(crate) struct BrowserSessions {
    cookie: SessionCookie,
    sessions: Arc<Mutex<Sessions>>,
}

impl BrowserSessions {
    pub(crate) fn new(is_encrypted: bool) -> BrowserSessions {
        let suffix = random_hex().unwrap_or_default();
        BrowserSessions {
            cookie: SessionCookie::new(suffix.get(..8).unwrap_or_default(), is_encrypted),
            sessions: Arc::default(),
        }
    }

    /// Starts a session. Returns the `Set-Cookie` value with its id, or `None` if the system
    /// provides no randomness.
    pub(crate) fn log_in(&self) -> Option<String> {
        let session = self.sessions().begin(Instant::now())?;
        Some(self.cookie.set(&session, SESSION_LIFETIME.as_secs()))
    }

    /// Ends the session of a request. Returns the `Set-Cookie` value that deletes the cookie.
    pub(crate) fn log_out(&self, headers: &HeaderMap) -> String {
        if let Some(session) = self.cookie.session(headers) {
            self.sessions().end(session);
        }
        self.cookie.set("", 0)
    }

    /// Returns true if a request carries the id of an open session.
    pub(crate) fn has_session(&self, headers: &HeaderMap) -> bool {
        let session = self.cookie.session(headers);
        session.is_some_and(|session| self.sessions().is_open(session, Instant::now()))
    }

    fn sessions(&self) -> MutexGuard<'_, Sessions> {
        // No thread panics while it holds this lock.
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[derive(Debug, Default)]
struct Sessions {
    /// End of each session, keyed by the SHA-256 of its id, so that lookup times reveal nothing
    /// about ids.
    ends: HashMap<[u8; 32], Instant>,
}

impl Sessions {
    /// Starts a session. Returns its id, or `None` if the system provides no randomness.
    fn begin(&mut self, now: Instant) -> Option<String> {
        self.ends.retain(|_, end| *end > now);
        if self.ends.len() >= MAX_SESSIONS {
            let oldest = self.ends.iter().min_by_key(|(_, end)| **end);
            let oldest = oldest.map(|(digest, _)| *digest);
            oldest.and_then(|digest| self.ends.remove(&digest));
        }
        let id = random_hex()?;
        self.ends.insert(digest(&id), now + SESSION_LIFETIME);
        Some(id)
    }

    /// Returns true if the session exists and has not ended.
    fn is_open(&self, id: &str, now: Instant) -> bool {
        self.ends.get(&digest(id)).is_some_and(|end| *end > now)
    }

    fn end(&mut self, id: &str) {
        self.ends.remove(&digest(id));
    }
}

/// Returns 128 random bits from the operating system, in hex.
fn random_hex() -> Option<String> {
    let mut bytes = [0; SESSION_ID_BYTES];
    let read = getrandom(&mut bytes, GetRandomFlags::empty()).ok()?;
    (read == SESSION_ID_BYTES).then(|| hex::encode(bytes))
}

fn digest(id: &str) -> [u8; 32] {
    Sha256::digest(id.as_bytes()).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_session_is_open_until_it_expires_or_is_ended() {
        let mut sessions = Sessions::default();
        let start = Instant::now();
        let [first, second] = [0; 2].map(|_| sessions.begin(start).expect("randomness"));
        assert_ne!(first, second);
        assert_eq!(first.len(), 2 * SESSION_ID_BYTES);
        let last = start + SESSION_LIFETIME - Duration::from_secs(1);
        assert!(sessions.is_open(&first, last) && sessions.is_open(&second, last));
        sessions.end(&first);
        assert!(!sessions.is_open(&first, last) && sessions.is_open(&second, last));
        assert!(!sessions.is_open(&second, start + SESSION_LIFETIME));
        assert!(!sessions.is_open("", start));
    }

    #[test]
    fn sessions_are_bounded_and_the_oldest_is_dropped() {
        let mut sessions = Sessions::default();
        let start = Instant::now();
        let first = sessions.begin(start).expect("randomness");
        let later = start + Duration::from_secs(1);
        let others: Vec<String> = (0..MAX_SESSIONS).filter_map(|_| sessions.begin(later)).collect();
        assert_eq!(sessions.ends.len(), MAX_SESSIONS);
        assert!(!sessions.is_open(&first, later));
        assert!(others.iter().all(|id| sessions.is_open(id, later)));
        let much_later = later + SESSION_LIFETIME;
        assert!(sessions.begin(much_later).is_some());
        assert_eq!(sessions.ends.len(), 1);
    }
}
