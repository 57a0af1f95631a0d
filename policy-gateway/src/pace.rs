//! Measures the pace at which a policy server answers queries, and detects a silent server, which
//! answers no query. [`Pace`] is pure: callers pass in the time. [`Watch`] applies the pace to
//! calls.
//!
//! A server with a long queue takes long for each query without being silent, because it answers
//! other queries meanwhile. So a call has failed only if the server answered no query at all for
//! the longest allowed time since the call was sent. Time in the gateway's own queue does not
//! count.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

const SAMPLES: usize = 32;
/// Smallest number of answers for an average.
const MIN_SAMPLES: usize = 8;

/// Recent answers of a server, and its calls in flight.
#[derive(Debug, Default)]
pub struct Pace {
    /// Number of calls with queries in flight.
    in_flight: usize,
    /// Time at which the server last became busy.
    busy_since: Option<Instant>,
    last_answer: Option<Instant>,
    /// Time to each answer from the previous answer or, if later, from the time at which the server
    /// became busy; with the number of queries answered.
    samples: VecDeque<(Duration, u32)>,
}

impl Pace {
    pub fn sent(&mut self, now: Instant) {
        if self.in_flight == 0 {
            self.busy_since = Some(now);
        }
        self.in_flight += 1;
    }

    pub fn answered(&mut self, queries: u32, now: Instant) {
        if let Some(began) = self.busy_since.max(self.last_answer) {
            if self.samples.len() == SAMPLES {
                self.samples.pop_front();
            }
            let took = now.saturating_duration_since(began);
            self.samples.push_back((took, queries.max(1)));
        }
        self.last_answer = Some(now);
    }

    /// Records that a call has ended, answered or not.
    pub fn ended(&mut self) {
        self.in_flight = self.in_flight.saturating_sub(1);
    }

    /// Returns the time at which the server will have been silent for `limit` since a call was sent
    /// at `sent`, unless the server answers a query before.
    pub fn silent_at(&self, sent: Instant, limit: Duration) -> Instant {
        self.last_answer.map_or(sent, |last| last.max(sent)) + limit
    }

    /// Returns the average time per answered query while the server is busy, with batches counted
    /// by their queries. Leaves out the longest answer, which may include a model's compilation.
    /// `None` until there are enough answers.
    pub fn per_query(&self) -> Option<Duration> {
        if self.samples.len() < MIN_SAMPLES {
            return None;
        }
        let longest = self.samples.iter().max_by_key(|(took, _)| *took)?;
        let took: Duration = self.samples.iter().map(|(took, _)| *took).sum();
        let queries: u32 = self.samples.iter().map(|(_, queries)| *queries).sum();
        Some((took - longest.0) / (queries - longest.1).max(1))
    }
}

/// Pace of one server, shared by all calls to it.
#[derive(Debug, Default)]
pub struct Watch(Mutex<Pace>);

/// Guard of a call with queries in flight; dropping it removes the call from the count.
struct CallInFlight<'a>(&'a Watch);

impl Drop for CallInFlight<'_> {
    fn drop(&mut self) {
        self.0.pace().ended();
    }
}

/// The server has answered no query within the limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoAnswer;

impl Watch {
    /// Waits for the answer to a call, until the server has been silent for `limit` since the call
    /// was sent. Records nothing; calls with queries use [`Self::queries`].
    pub async fn answer<T>(
        &self,
        limit: Duration,
        call: impl Future<Output = T>,
    ) -> Result<T, NoAnswer> {
        let sent = Instant::now();
        let mut call = std::pin::pin!(call);
        loop {
            let until = self.pace().silent_at(sent, limit);
            if until <= Instant::now() {
                return Err(NoAnswer);
            }
            tokio::select! {
                answer = &mut call => return Ok(answer),
                () = tokio::time::sleep_until(until.into()) => {}
            }
        }
    }

    /// Waits for the answer to a call with queries. `answered` returns how many of the queries were
    /// answered, which shows that the server is alive.
    pub async fn queries<T>(
        &self,
        limit: Duration,
        call: impl Future<Output = T>,
        answered: impl FnOnce(&T) -> u32,
    ) -> Result<T, NoAnswer> {
        self.pace().sent(Instant::now());
        let _sent = CallInFlight(self);
        let answer = self.answer(limit, call).await?;
        let count = answered(&answer);
        if count > 0 {
            self.pace().answered(count, Instant::now());
        }
        Ok(answer)
    }

    /// See [`Pace::per_query`].
    pub fn per_query(&self) -> Option<Duration> {
        self.pace().per_query()
    }

    fn pace(&self) -> std::sync::MutexGuard<'_, Pace> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: Duration = Duration::from_secs(50);

    fn millis(millis: u64) -> Duration {
        Duration::from_millis(millis)
    }

    #[test]
    fn a_busy_server_is_silent_only_after_answering_no_query_for_the_limit() {
        let (mut pace, began) = (Pace::default(), Instant::now());
        pace.sent(began);
        pace.sent(began);
        assert_eq!(pace.silent_at(began, LIMIT), began + LIMIT);
        pace.answered(1, began + millis(400));
        assert_eq!(pace.silent_at(began, LIMIT), began + millis(400) + LIMIT, "the server is busy");
        let later = began + millis(500);
        assert_eq!(pace.silent_at(later, LIMIT), later + LIMIT);
    }

    #[test]
    fn the_pace_counts_neither_idle_time_nor_the_slowest_answer() {
        let (mut pace, mut now) = (Pace::default(), Instant::now());
        for answer in 0..u64::from(MIN_SAMPLES as u32) {
            assert_eq!(pace.per_query(), None);
            pace.sent(now);
            now += millis(if answer == 2 { 30_000 } else { 400 });
            pace.answered(1, now);
            pace.ended();
            now += millis(2_000);
        }
        assert_eq!(pace.per_query(), Some(millis(400)));
    }

    #[test]
    fn a_batch_counts_as_all_its_queries() {
        let (mut pace, mut now) = (Pace::default(), Instant::now());
        pace.sent(now);
        for _ in 0..MIN_SAMPLES {
            pace.sent(now);
            now += millis(320);
            pace.answered(16, now);
            pace.ended();
        }
        assert_eq!(pace.per_query(), Some(millis(20)));
    }
}
