//! Generates random operations, each with its relative frequency.

use proptest::prelude::*;

/// An operation. Its numbers select among the items that exist at that moment.
#[derive(Debug, Clone)]
pub enum Op {
    Register(usize),
    Acquire {
        worker: usize,
        max: usize,
    },
    /// Renews the leases that the bits of `which` select; those that the bits of `running` select are reported as running.
    Renew {
        worker: usize,
        which: u8,
        running: u8,
    },
    /// Claims leases with keys that were never granted in this form.
    Forge {
        worker: usize,
        lease: usize,
        how: u8,
    },
    /// A result, from admission to acknowledgement.
    Deliver {
        worker: usize,
        lease: usize,
    },
    /// A result is admitted, but not stored yet.
    Begin {
        worker: usize,
        lease: usize,
    },
    /// An admitted result reaches the store.
    End(usize),
    /// A result reaches the store and differs from the records of a job with the same walks.
    Clash {
        which: usize,
        with: usize,
    },
    /// A result of a lease that was lost, handed back or delivered before.
    DeliverOld {
        worker: usize,
        lease: usize,
    },
    /// A result with a different identity.
    DeliverAlien {
        worker: usize,
        lease: usize,
    },
    Fail {
        worker: usize,
        lease: usize,
    },
    HandBack {
        worker: usize,
        lease: usize,
    },
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
    Damage {
        dictionary: usize,
        job: u32,
    },
    Restart,
}

pub fn any() -> impl Strategy<Value = Op> {
    let (w, l, d) = (0_usize..5, 0_usize..6, 0_usize..5);
    let clash = |(which, with)| Op::Clash { which, with };
    let wl = || (0_usize..5, 0_usize..6);
    prop_oneof![
        3 => w.clone().prop_map(Op::Register),
        16 => (w.clone(), 1_usize..4).prop_map(|(worker, max)| Op::Acquire { worker, max }),
        8 => (w.clone(), any_bits(), any_bits())
            .prop_map(|(worker, which, running)| Op::Renew { worker, which, running }),
        1 => (wl(), 0_u8..5).prop_map(|((worker, lease), how)| Op::Forge { worker, lease, how }),
        14 => wl().prop_map(|(worker, lease)| Op::Deliver { worker, lease }),
        5 => wl().prop_map(|(worker, lease)| Op::Begin { worker, lease }),
        1 => (l.clone(), 0_usize..8).prop_map(clash),
        6 => l.prop_map(Op::End),
        5 => wl().prop_map(|(worker, lease)| Op::DeliverOld { worker, lease }),
        1 => wl().prop_map(|(worker, lease)| Op::DeliverAlien { worker, lease }),
        4 => wl().prop_map(|(worker, lease)| Op::Fail { worker, lease }),
        3 => wl().prop_map(|(worker, lease)| Op::HandBack { worker, lease }),
        1 => w.clone().prop_map(Op::Leave),
        1 => w.clone().prop_map(Op::Drain),
        2 => w.prop_map(Op::Die),
        12 => (0_u64..50).prop_map(Op::Expire),
        1 => (1_u64..700).prop_map(Op::Stall),
        1 => d.clone().prop_map(Op::Pause),
        2 => d.clone().prop_map(Op::Resume),
        1 => d.clone().prop_map(Op::Cancel),
        2 => d.clone().prop_map(Op::Retry),
        1 => (d.clone(), -2_i32..3).prop_map(|(dictionary, to)| Op::Priority(dictionary, to)),
        1 => d.clone().prop_map(Op::Delete),
        3 => d.clone().prop_map(Op::Submit),
        2 => (d, 0_u32..3).prop_map(|(dictionary, job)| Op::Damage { dictionary, job }),
        1 => Just(Op::Restart),
    ]
}

fn any_bits() -> impl Strategy<Value = u8> {
    proptest::num::u8::ANY
}
