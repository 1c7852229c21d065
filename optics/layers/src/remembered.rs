//! Remembers what takes long to compute, by the numbers that it follows from.

use std::collections::HashMap;
use std::sync::{Arc, LazyLock, Mutex, OnceLock, PoisonError};

type KnownValues<V> = HashMap<Vec<u64>, Arc<OnceLock<V>>>;

/// Values by their keys; when there are too many, all are forgotten.
pub(crate) struct Remembered<V> {
    most: usize,
    known: LazyLock<Mutex<KnownValues<V>>>,
}

impl<V: Clone> Remembered<V> {
    pub(crate) const fn new(most: usize) -> Self {
        Self { most, known: LazyLock::new(Mutex::default) }
    }

    /// The value of a key. Of threads that ask for the same one, one computes it, and the others wait: so `value` must not
    /// wait for a thread pool.
    pub(crate) fn get(&self, key: Vec<u64>, value: impl FnOnce() -> V) -> V {
        let cell = {
            let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
            if known.len() >= self.most && !known.contains_key(&key) {
                known.clear();
            }
            known.entry(key).or_default().clone()
        };
        cell.get_or_init(value).clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A value is computed once, and again after it was forgotten.
    #[test]
    fn values_are_computed_once() {
        let remembered = Remembered::new(2);
        assert_eq!(remembered.get(vec![1], || 10), 10);
        assert_eq!(remembered.get(vec![1], || unreachable!()), 10);
        for key in 2..4 {
            remembered.get(vec![key], || 0);
        }
        assert_eq!(remembered.get(vec![1], || 11), 11);
    }
}
