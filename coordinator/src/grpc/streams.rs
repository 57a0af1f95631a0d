//! Streams of large answers: reports, archives and backups. Each keeps a reader of the database, the
//! whole answer in memory or a copy on the disk, so only a few are made at a time, and a client that
//! does not read its stream loses it. Exports keep nothing between their pages and may be paused.

use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use futures_util::stream::unfold;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio::task::JoinSet;
use tokio::time::timeout;
use tokio_stream::{Stream, StreamExt};
use tonic::Status;

/// Number of large answers at a time; further callers wait.
const LARGE_ANSWERS: usize = 2;
/// Longest wait for a client to take the next message.
const SEND_TIMEOUT: Duration = Duration::from_secs(30);

pub(super) type Large<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

/// The turns of callers who want a large answer.
#[derive(Debug)]
pub(super) struct Turns {
    permits: Arc<Semaphore>,
    /// Longest wait for a client to take the next message.
    patience: Duration,
}

impl Default for Turns {
    fn default() -> Self {
        Self { permits: Arc::new(Semaphore::new(LARGE_ANSWERS)), patience: SEND_TIMEOUT }
    }
}

impl Turns {
    /// Waits for the caller's turn, which ends with its stream.
    pub(super) async fn wait(&self) -> Result<Turn, Status> {
        let permit = self.permits.clone().acquire_owned().await;
        let permit = permit.map_err(|_| Status::unavailable("answer: the coordinator stops"))?;
        Ok(Turn { permit, patience: self.patience })
    }
}

/// A caller's turn.
#[derive(Debug)]
pub(super) struct Turn {
    permit: OwnedSemaphorePermit,
    patience: Duration,
}

impl Turn {
    /// Sends the messages of an answer as fast as the client takes them.
    pub(super) fn send<T: Send + 'static>(
        self,
        mut messages: impl Stream<Item = Result<T, Status>> + Send + Unpin + 'static,
    ) -> Large<T> {
        let Self { permit, patience } = self;
        let (sender, receiver) = mpsc::channel(1);
        let mut sending = JoinSet::new();
        sending.spawn(async move {
            let _permit = permit;
            while let Some(message) = messages.next().await {
                // A client that has disconnected needs no further messages.
                let Ok(Ok(())) = timeout(patience, sender.send(message)).await else {
                    return false;
                };
            }
            true
        });
        let state = (receiver, sending);
        Box::pin(unfold(state, move |(mut receiver, mut sending)| async move {
            if let Some(message) = receiver.recv().await {
                return Some((message, (receiver, sending)));
            }
            // The task has ended; there is none after its failure was reported.
            let was_sent = sending.join_next().await.is_none_or(|sent| sent.unwrap_or(false));
            let cut_off = Status::aborted(format!(
                "send the rest: it was not read for {} s; try again",
                patience.as_secs_f64()
            ));
            (!was_sent).then_some((Err(cut_off), (receiver, sending)))
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_client_that_does_not_read_keeps_nobody_from_a_large_answer() {
        let patience = Duration::from_millis(200);
        let turns = Turns { patience, ..Turns::default() };
        let numbers = || tokio_stream::iter((0..9).map(Ok));
        let mut unread = Vec::new();
        for _ in 0..LARGE_ANSWERS {
            let mut stream = turns.wait().await.expect("a turn").send(numbers());
            assert_eq!(stream.next().await.map(|first| first.ok()), Some(Some(0)));
            unread.push(stream);
        }
        assert!(timeout(patience / 2, turns.wait()).await.is_err(), "too many at a time");
        let all: Vec<_> = turns.wait().await.expect("a turn").send(numbers()).collect().await;
        assert_eq!(all.len(), 9);
        for stream in unread {
            let last = stream.collect::<Vec<_>>().await.pop().expect("messages");
            let cut_off = last.expect_err("not taken for complete");
            assert!(cut_off.message().contains("not read for 0.2 s"), "{cut_off}");
        }
    }
}
