//! Encodes results as messages: a header, then the bytes in pieces.

use std::time::Duration;

use bytes::Bytes;
use farm_proto::wire::complete_request::Content;
use farm_proto::wire::{CompleteRequest, ResultHeader};

use super::PendingResult;
use crate::pool::TraceResult;

/// Bytes of one piece of a result.
const PIECE: usize = 1 << 20;

/// The messages of a call that delivers results with a worker's token.
pub(super) fn result_messages(worker_token: &str, results: &[PendingResult]) -> Vec<CompleteRequest> {
    let mut messages = Vec::new();
    let mut push = |content| messages.push(CompleteRequest { content: Some(content) });
    for PendingResult { key, identity, result, .. } in results {
        push(Content::Header(ResultHeader {
            worker_token: worker_token.to_owned(),
            key: Some((*key).into()),
            identity: identity.as_bytes().to_vec(),
        }));
        match result {
            TraceResult::Records(records) => pieces(records.bytes()).for_each(|p| push(Content::Records(p))),
            TraceResult::Sums(sums) => {
                pieces(&sums.to_le_bytes().into()).for_each(|p| push(Content::Sums(p)));
            }
        }
    }
    messages
}

fn pieces(bytes: &Bytes) -> impl Iterator<Item = Bytes> {
    (0..bytes.len()).step_by(PIECE).map(|start| bytes.slice(start..bytes.len().min(start + PIECE)))
}

/// Time limit of a call that delivers this many bytes.
pub(super) fn time_limit(bytes: usize) -> Duration {
    /// Slowest link, in bytes a second, on which a delivery completes before it times out and is repeated.
    const SLOWEST: f64 = 50_000.0;
    Duration::from_mins(1) + Duration::from_secs_f64(bytes as f64 / SLOWEST)
}

#[cfg(test)]
mod tests {
    use farm_proto::RequestLimits;

    use super::*;

    /// Pieces fit into a message and together form the whole.
    #[test]
    fn pieces_fit_messages_and_form_the_whole() {
        for len in [0, 1, PIECE - 1, PIECE, PIECE + 1, 3 * PIECE + 5] {
            let whole: Bytes = (0..len).map(|i| (i % 251) as u8).collect();
            let pieces: Vec<Bytes> = pieces(&whole).collect();
            assert_eq!(pieces.concat(), whole);
            assert!(pieces.iter().all(|p| !p.is_empty() && p.len() <= RequestLimits::MESSAGE_BYTES / 2));
        }
    }

    /// The time limit grows with the bytes, so that a slow link suffices.
    #[test]
    fn time_limit_grows_with_bytes() {
        assert_eq!(time_limit(0), Duration::from_mins(1));
        assert_eq!(time_limit(6_000_000), Duration::from_mins(3));
    }
}
