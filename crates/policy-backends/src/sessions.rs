//! Bounded table of open sessions. Callers do not end every session, so a full table discards the
//! session idle for longest.

use std::collections::HashMap;

/// Largest number of sessions kept per route: twice the 2,000 slots that a coordinator is designed
/// for, so that a discarded session has usually ended.
pub const MAX_SESSIONS: usize = 4096;
/// Longest session name accepted, bytes.
pub const MAX_SESSION_BYTES: usize = 512;

#[derive(Debug)]
pub struct SessionTable<V> {
    capacity: usize,
    /// Number of uses, which orders sessions by idleness without a clock.
    uses: u64,
    entries: HashMap<String, Entry<V>>,
}

#[derive(Debug)]
struct Entry<V> {
    value: V,
    last_use: u64,
}

impl<V> SessionTable<V> {
    /// Creates an empty table for `capacity` sessions (at least one).
    pub fn new(capacity: usize) -> Self {
        Self { capacity: capacity.max(1), uses: 0, entries: HashMap::new() }
    }

    /// Opens a session, replacing a session of the same name. If the table is full, discards the
    /// session idle for longest.
    pub fn open(&mut self, session: &str, value: V) -> &mut V {
        if !self.entries.contains_key(session) && self.entries.len() >= self.capacity {
            self.discard_idlest();
        }
        let last_use = self.next_use();
        let entry = Entry { value, last_use };
        &mut self.entries.entry(session.to_owned()).insert_entry(entry).into_mut().value
    }

    /// Counts the use.
    pub fn get(&mut self, session: &str) -> Option<&mut V> {
        let last_use = self.next_use();
        let entry = self.entries.get_mut(session)?;
        entry.last_use = last_use;
        Some(&mut entry.value)
    }

    pub fn values(&self) -> impl Iterator<Item = &V> {
        self.entries.values().map(|entry| &entry.value)
    }

    pub fn close(&mut self, session: &str) -> Option<V> {
        self.entries.remove(session).map(|entry| entry.value)
    }

    pub fn retain(&mut self, mut keeps: impl FnMut(&V) -> bool) {
        self.entries.retain(|_, entry| keeps(&entry.value));
    }

    fn next_use(&mut self) -> u64 {
        self.uses += 1;
        self.uses
    }

    fn discard_idlest(&mut self) {
        let idlest = self.entries.iter().min_by_key(|(_, entry)| entry.last_use);
        if let Some(session) = idlest.map(|(session, _)| session.clone()) {
            self.entries.remove(&session);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_table_discards_the_session_idle_for_longest() {
        let mut table = SessionTable::new(2);
        table.open("a", 1);
        table.open("b", 2);
        assert_eq!(table.get("a").copied(), Some(1));
        table.open("c", 3);
        assert_eq!(table.get("b"), None);
        assert_eq!(table.get("a").copied(), Some(1));
        assert_eq!(table.get("c").copied(), Some(3));
    }

    #[test]
    fn opening_a_session_again_replaces_it_and_discards_no_other() {
        let mut table = SessionTable::new(2);
        table.open("a", 1);
        table.open("b", 2);
        table.open("b", 20);
        assert_eq!(table.get("a").copied(), Some(1));
        assert_eq!(table.get("b").copied(), Some(20));
    }
}
