//! Provides the lock between results that are being stored and records that are being deleted.
//!
//! It is held shared from the moment a result is handed to the store until the dispatcher has noted it, and exclusively
//! while records are deleted or replaced. So the dispatcher never counts a record as stored that was deleted in between.
//! The operations are methods of the guards: a caller without the right guard does not compile.

use std::ops::Deref;

use tokio::sync::{RwLockReadGuard, RwLockWriteGuard};

use super::Store;

/// The lock of a store's records.
#[derive(Debug, Clone, Copy)]
pub struct Ledger<'a>(&'a Store);

/// Access to the ledger while it is locked, for the operations that either guard allows.
#[derive(Debug)]
pub struct LedgerGuard<'a> {
    pub(super) store: &'a Store,
}

/// The lock held together with others, while results are stored and the dispatcher notes them.
#[derive(Debug)]
pub struct Shared<'a> {
    held: LedgerGuard<'a>,
    _guard: RwLockReadGuard<'a, ()>,
}

/// The lock held alone, while records are deleted or replaced.
#[derive(Debug)]
pub struct Exclusive<'a> {
    held: LedgerGuard<'a>,
    _guard: RwLockWriteGuard<'a, ()>,
}

impl Store {
    pub fn ledger(&self) -> Ledger<'_> {
        Ledger(self)
    }
}

impl<'a> Ledger<'a> {
    pub async fn shared(self) -> Shared<'a> {
        Shared { held: LedgerGuard { store: self.0 }, _guard: self.0.records.read().await }
    }

    pub async fn exclusive(self) -> Exclusive<'a> {
        Exclusive { held: LedgerGuard { store: self.0 }, _guard: self.0.records.write().await }
    }
}

impl<'a> Deref for Shared<'a> {
    type Target = LedgerGuard<'a>;

    fn deref(&self) -> &LedgerGuard<'a> {
        &self.held
    }
}

impl<'a> Deref for Exclusive<'a> {
    type Target = LedgerGuard<'a>;

    fn deref(&self) -> &LedgerGuard<'a> {
        &self.held
    }
}
