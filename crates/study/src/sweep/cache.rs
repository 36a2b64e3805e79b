//! Cache of values that variants share.
//!
//! Input: a key, and a function that makes its value. Output: the value, made once for any number
//! of threads that request it. Errors are not stored: the next request makes the value again. At
//! most `MOST` values are stored.

use std::collections::HashMap;
use std::hash::Hash;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Greatest number of stored values.
const MOST: usize = 64;

/// A value that one thread makes and others wait for.
type Place<V> = Arc<Mutex<Option<Arc<V>>>>;

/// Values by key; each is made once.
#[derive(Debug)]
pub struct SharedCache<K, V>(Mutex<HashMap<K, Place<V>>>);

impl<K, V> Default for SharedCache<K, V> {
    fn default() -> Self {
        SharedCache(Mutex::new(HashMap::new()))
    }
}

/// Locks a mutex, also after a panic: a thread that panicked has left nothing half changed.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<K: Hash + Eq, V> SharedCache<K, V> {
    /// The value of a key.
    ///
    /// # Errors
    /// The errors of `make`.
    pub fn get<E>(&self, key: K, make: impl FnOnce() -> Result<V, E>) -> Result<Arc<V>, E> {
        let place = {
            let mut places = lock(&self.0);
            if places.len() >= MOST && !places.contains_key(&key) {
                places.clear();
            }
            places.entry(key).or_default().clone()
        };
        let mut stored = lock(&place);
        if let Some(value) = &*stored {
            return Ok(value.clone());
        }
        let value = Arc::new(make()?);
        *stored = Some(value.clone());
        Ok(value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_is_made_once_and_an_error_is_not_kept() {
        let made = SharedCache::default();
        assert_eq!(made.get(1, || Err::<u8, _>("no")), Err("no"));
        assert_eq!(made.get(1, || Ok::<_, ()>(5)).as_deref(), Ok(&5));
        assert_eq!(made.get(1, || Ok::<_, ()>(6)).as_deref(), Ok(&5));
        (2..200).for_each(|key| drop(made.get(key, || Ok::<_, ()>(7))));
        assert!(lock(&made.0).len() <= MOST);
    }
}
