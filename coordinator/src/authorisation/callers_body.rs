//! What a caller says, as long as their token is let in: a stream of results may be long.

use std::pin::Pin;
use std::task::{Context, Poll, ready};

use http_body::{Body as HttpBody, Frame, SizeHint};
use tonic::Status;
use tonic::body::Body;

use super::permission::{self, Caller};
use crate::gate::Gate;

struct CallersBody {
    inner: Body,
    gate: Gate,
    caller: Caller,
}

/// The body of a caller's request, which ends with an error when the token is revoked.
pub(super) fn watched(inner: Body, gate: Gate, caller: Caller) -> Body {
    Body::new(CallersBody { inner, gate, caller })
}

impl HttpBody for CallersBody {
    type Data = <Body as HttpBody>::Data;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Self::Data>, Status>>> {
        let frame = ready!(Pin::new(&mut self.inner).poll_frame(cx));
        if frame.is_some() && !permission::is_let_in_still(&self.gate, &self.caller) {
            return Poll::Ready(Some(Err(permission::revoked(&self.caller))));
        }
        Poll::Ready(frame)
    }

    fn is_end_stream(&self) -> bool {
        self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}
