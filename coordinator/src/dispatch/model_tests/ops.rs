//! Generates random operations, each with its relative frequency.

use proptest::prelude::*;

/// An operation on a worker's process, on one of its leases, or on a dictionary. Its numbers select among the items that
/// exist at that moment.
#[derive(Debug, Clone)]
pub enum Op {
    Register(usize),
    /// Requests at most this number of leases.
    Acquire(usize, usize),
    /// Renews the leases that the first bits select; those that the second bits select are reported as running.
    Renew(usize, u8, u8),
    /// Claims a lease with a key that was never granted in this form.
    Forge(usize, usize, u8),
    /// A result, from admission to acknowledgement.
    Deliver(usize, usize),
    /// A result is admitted, but not stored yet.
    Begin(usize, usize),
    /// An admitted result reaches the store.
    End(usize),
    /// A result reaches the store and differs from the records of a job with the same walks.
    Clash(usize, usize),
    /// A result of a lease that was lost, handed back or delivered before.
    DeliverOld(usize, usize),
    /// A result with a different identity.
    DeliverAlien(usize, usize),
    Fail(usize, usize),
    HandBack(usize, usize),
    Leave(usize),
    Drain(usize),
    /// The process dies, and another begins in its place.
    Die(usize),
    /// Looks for silent workers after this many tenths of a second.
    Expire(u64),
    /// The coordinator does nothing for this many seconds.
    Stall(u64),
    Pause(usize),
    Resume(usize),
    Cancel(usize),
    Retry(usize),
    Priority(usize, i32),
    Delete(usize),
    Submit(usize),
    /// The disk damages the records of a job.
    Damage(usize, u32),
    /// The coordinator begins to compute something itself, or ends it.
    Judge,
    Restart,
}

pub fn any() -> impl Strategy<Value = Op> {
    let (w, d) = (|| 0_usize..5, || 0_usize..5);
    // An operation on one of a worker's leases.
    let wl = |op: fn(usize, usize) -> Op| (0_usize..5, 0_usize..6).prop_map(move |(w, l)| op(w, l));
    let bits = || proptest::num::u8::ANY;
    prop_oneof![
        3 => w().prop_map(Op::Register),
        16 => (w(), 1_usize..4).prop_map(|(worker, max)| Op::Acquire(worker, max)),
        8 => (w(), bits(), bits()).prop_map(|(worker, which, running)| Op::Renew(worker, which, running)),
        1 => (w(), 0_usize..6, 0_u8..5).prop_map(|(worker, lease, how)| Op::Forge(worker, lease, how)),
        14 => wl(Op::Deliver),
        5 => wl(Op::Begin),
        1 => (0_usize..6, 0_usize..8).prop_map(|(which, with)| Op::Clash(which, with)),
        6 => (0_usize..6).prop_map(Op::End),
        5 => wl(Op::DeliverOld),
        1 => wl(Op::DeliverAlien),
        4 => wl(Op::Fail),
        3 => wl(Op::HandBack),
        1 => w().prop_map(Op::Leave),
        1 => w().prop_map(Op::Drain),
        2 => w().prop_map(Op::Die),
        12 => (0_u64..50).prop_map(Op::Expire),
        1 => (1_u64..700).prop_map(Op::Stall),
        1 => d().prop_map(Op::Pause),
        2 => d().prop_map(Op::Resume),
        1 => d().prop_map(Op::Cancel),
        2 => d().prop_map(Op::Retry),
        1 => (d(), -2_i32..3).prop_map(|(dictionary, to)| Op::Priority(dictionary, to)),
        1 => d().prop_map(Op::Delete),
        3 => d().prop_map(Op::Submit),
        2 => (d(), 0_u32..3).prop_map(|(dictionary, job)| Op::Damage(dictionary, job)),
        8 => Just(Op::Judge),
        1 => Just(Op::Restart),
    ]
}
