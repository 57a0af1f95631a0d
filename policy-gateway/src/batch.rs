//! Queue that decides which queries form a batch, and when the batch is sent. Pure: callers pass
//! in the time. [`batcher`] carries out the decisions.
//!
//! A full batch is sent as soon as the server can take one more batch; a partial batch is sent when
//! the server is idle and the oldest query has waited [`MAX_WAIT`].

use std::collections::VecDeque;
use std::time::{Duration, Instant};

pub mod batcher;

/// Longest time that a query waits for its batch to fill while the server is idle.
pub const MAX_WAIT: Duration = Duration::from_millis(5);
/// Largest number of queries in the queue of one replica. Further queries are refused, so that
/// workers wait and the gateway's memory does not grow.
pub const MAX_QUEUED: usize = 256;
/// Concurrent batches per server: the second is in transit while the first is computed.
pub const MAX_IN_FLIGHT: usize = 2;

/// Queries waiting for a batch, in order of arrival.
#[derive(Debug)]
pub struct Queue<T> {
    waiting: VecDeque<(Instant, T)>,
    in_flight: usize,
}

#[derive(Debug, PartialEq, Eq)]
pub enum Next<T> {
    /// Send this batch, and call [`Queue::done`] when it has ended.
    Send(Vec<T>),
    /// Call [`Queue::next`] again at this time, or earlier if the queue changes.
    WaitUntil(Instant),
    /// Call [`Queue::next`] again when the queue changes.
    Nothing,
}

impl<T> Default for Queue<T> {
    fn default() -> Self {
        Self { waiting: VecDeque::new(), in_flight: 0 }
    }
}

impl<T> Queue<T> {
    /// Adds a query. Returns the query if [`MAX_QUEUED`] queries are waiting already.
    pub fn push(&mut self, query: T, now: Instant) -> Result<(), T> {
        if self.waiting.len() >= MAX_QUEUED {
            return Err(query);
        }
        self.waiting.push_back((now, query));
        Ok(())
    }

    /// Removes the queries whose callers stopped waiting.
    pub fn forget(&mut self, is_abandoned: impl Fn(&T) -> bool) {
        self.waiting.retain(|(_, query)| !is_abandoned(query));
    }

    pub fn drain(&mut self) -> Vec<T> {
        self.waiting.drain(..).map(|(_, query)| query).collect()
    }

    pub fn next(&mut self, size: usize, now: Instant) -> Next<T> {
        let size = size.max(1);
        let Some((oldest, _)) = self.waiting.front() else {
            return Next::Nothing;
        };
        let send_at = *oldest + MAX_WAIT;
        let is_full = self.waiting.len() >= size;
        match self.in_flight {
            0 if !is_full && now < send_at => return Next::WaitUntil(send_at),
            1..MAX_IN_FLIGHT if !is_full => return Next::Nothing,
            MAX_IN_FLIGHT.. => return Next::Nothing,
            _ => {}
        }
        self.in_flight += 1;
        let batch = self.waiting.drain(..size.min(self.waiting.len()));
        Next::Send(batch.map(|(_, query)| query).collect())
    }

    /// Records that a batch has ended, answered or not.
    pub fn done(&mut self) {
        self.in_flight = self.in_flight.saturating_sub(1);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[derive(Clone, Debug)]
    enum Event {
        Push(usize),
        Next,
        Done,
        Pass(u64),
    }

    fn event() -> impl Strategy<Value = Event> {
        prop_oneof![
            (1..40_usize).prop_map(Event::Push),
            Just(Event::Next),
            Just(Event::Done),
            (0..8_u64).prop_map(Event::Pass),
        ]
    }

    proptest! {
        #[test]
        fn every_accepted_query_is_sent_once_in_order_and_within_the_bounds(
            size in 1..20_usize,
            events in prop::collection::vec(event(), 0..120),
        ) {
            let (mut queue, mut now) = (Queue::default(), Instant::now());
            let (mut accepted, mut sent, mut in_flight) = (vec![], vec![], 0_usize);
            let mut number = 0_u32;
            for event in events {
                match event {
                    Event::Push(count) => for _ in 0..count {
                        match queue.push(number, now) {
                            Ok(()) => accepted.push(number),
                            Err(refused) => prop_assert_eq!(refused, number),
                        }
                        number += 1;
                    },
                    Event::Next => if let Next::Send(batch) = queue.next(size, now) {
                        prop_assert!((1..=size).contains(&batch.len()));
                        sent.extend(batch);
                        in_flight += 1;
                    },
                    Event::Done => {
                        queue.done();
                        in_flight = in_flight.saturating_sub(1);
                    }
                    Event::Pass(millis) => now += Duration::from_millis(millis),
                }
                prop_assert!(in_flight <= MAX_IN_FLIGHT);
                prop_assert!(accepted.len() - sent.len() <= MAX_QUEUED);
                prop_assert_eq!(&accepted[..sent.len()], &sent[..]);
            }
            // When the server is free, all waiting queries are sent, each batch after at most one
            // wait.
            while in_flight > 0 {
                queue.done();
                in_flight -= 1;
            }
            now += MAX_WAIT;
            while let Next::Send(batch) = queue.next(size, now) {
                sent.extend(batch);
                queue.done();
            }
            prop_assert_eq!(accepted, sent);
        }
    }

    #[test]
    fn a_single_query_is_sent_after_the_longest_wait() {
        let (mut queue, now) = (Queue::default(), Instant::now());
        queue.push("a", now).expect("space in the queue");
        assert_eq!(queue.next(2, now), Next::WaitUntil(now + MAX_WAIT));
        assert_eq!(queue.next(2, now + MAX_WAIT), Next::Send(vec!["a"]));
    }

    #[test]
    fn during_a_batch_only_one_more_full_batch_is_sent() {
        let (mut queue, now) = (Queue::default(), Instant::now());
        for query in 0..7 {
            queue.push(query, now).expect("space in the queue");
        }
        let late = now + 10 * MAX_WAIT;
        assert_eq!(queue.next(3, now), Next::Send(vec![0, 1, 2]));
        assert_eq!(queue.next(3, now), Next::Send(vec![3, 4, 5]));
        assert_eq!(queue.next(3, late), Next::Nothing);
        queue.done();
        assert_eq!(queue.next(3, late), Next::Nothing, "a single query waits for a free server");
        queue.done();
        assert_eq!(queue.next(3, late), Next::Send(vec![6]));
    }
}
