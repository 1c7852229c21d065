//! The quotas of results that are being received or stored: their number and their memory.
//!
//! Memory is taken as bytes arrive, so a result that is only announced holds next to nothing. Each machine and each access
//! token has a share; a result for which none is left waits. One result at a time goes on without, so that results cannot
//! wait for each other for ever.

use std::sync::Arc;

use crate::quota::{Held, Limit, Quota};
use crate::stored::Machine;

/// Memory of all results.
const BYTES: u64 = 512 << 20;
/// Calls that deliver results at a time: each may hold a message that has not come whole.
const CALLS: u64 = 256;

#[derive(Debug)]
pub(super) struct ResultRoom {
    calls: Arc<Quota>,
    bytes: Arc<Quota>,
    /// For the one result that goes on without memory of its own.
    overdraft: Arc<Quota>,
}

impl Default for ResultRoom {
    fn default() -> Self {
        let [calls, bytes, overdraft] = ["deliveries", "bytes of results", "results without memory"]
            .map(|what| Quota::new(what, "wait until others are stored"));
        Self { calls, bytes, overdraft }
    }
}

/// The memory that one result has taken, until it is dropped.
#[derive(Debug, Default)]
pub(super) struct Taken {
    held: Vec<Held>,
    overdraft: Option<Held>,
}

impl ResultRoom {
    /// Waits for the turn of a call that delivers results.
    pub async fn call(&self, machine: &Machine) -> Held {
        self.calls.wait(limits(machine, CALLS), 1).await
    }

    /// Waits for memory for more bytes of a result.
    pub async fn take(&self, machine: &Machine, taken: &mut Taken, bytes: usize) {
        if taken.overdraft.is_some() {
            return;
        }
        tokio::select! {
            biased;
            held = self.bytes.wait(limits(machine, BYTES), bytes as u64) => taken.held.push(held),
            overdraft = self.overdraft.wait(vec![Limit::all_callers(1)], 1) => taken.overdraft = Some(overdraft),
        }
    }

    /// The reason why results wait, if any do.
    pub fn shortage(&self) -> Option<String> {
        let (waiting, all, (most, who)) = self.bytes.shortage()?;
        let [all, of, most] = [all, BYTES, most].map(|bytes| bytes >> 20);
        Some(format!(
            "results wait for room in the coordinator's memory, {waiting} now: {all} of {of} MiB are taken, {most} of them \
             by {who}"
        ))
    }
}

/// Half of all is for one token, whatever the number of its machines, and a quarter for one machine.
fn limits(machine: &Machine, all: u64) -> Vec<Limit> {
    let token = format!("token {}", machine.token);
    vec![Limit::all_callers(all), Limit::new(token, all / 2), Limit::new(machine.identity(), all / 4)]
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    const MIB: usize = 1 << 20;

    async fn soon(future: impl Future<Output = ()>) -> bool {
        tokio::time::timeout(Duration::from_millis(50), future).await.is_ok()
    }

    fn machine(token: &str, address: &str) -> Machine {
        Machine { token: token.to_owned(), ..Machine::at(address) }
    }

    /// Neither one machine nor one token, whatever the number of its addresses, takes the memory of others. Results that
    /// wait are reported, and go on when memory is free.
    #[tokio::test(start_paused = true)]
    async fn one_caller_leaves_memory_for_others() {
        let room = ResultRoom::default();
        let machines = ["10.0.0.1", "10.0.0.2", "10.0.0.3"].map(|address| machine("node", address));
        let [mut first, mut second, mut overdraft, mut rest, mut of_other] =
            [(); 5].map(|()| Taken::default());
        room.take(&machines[0], &mut first, 128 * MIB).await;
        assert!(soon(room.take(&machines[0], &mut overdraft, MIB)).await, "one goes on without");
        assert!(soon(room.take(&machines[0], &mut overdraft, 500 * MIB)).await);
        assert!(!soon(room.take(&machines[0], &mut rest, MIB)).await, "the machine has its share");
        room.take(&machines[1], &mut second, 128 * MIB).await;
        assert_eq!(room.shortage(), None);
        let mut waiting = Box::pin(room.take(&machines[2], &mut rest, MIB));
        assert!(!soon(waiting.as_mut()).await, "the token has its share");
        assert_eq!(
            room.shortage().unwrap(),
            "results wait for room in the coordinator's memory, 1 now: 256 of 512 MiB are taken, 256 of them by token node"
        );
        assert!(soon(room.take(&machine("other", "10.0.0.1"), &mut of_other, 128 * MIB)).await);
        drop(first);
        assert!(soon(waiting.as_mut()).await);
        drop(waiting);
        assert_eq!(room.shortage(), None);
    }
}
