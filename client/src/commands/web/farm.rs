//! Connects the page to its farm, and reconnects after the farm has ended.

use std::sync::Arc;
use std::time::Duration;

use anyhow::Result;
use axum::http::{Request, Response, Uri};
use farm_link::failure;
use tokio::sync::Mutex;
use tokio_util::sync::CancellationToken;
use tonic::Status;
use tonic::body::Body;
use tonic::codegen::Service;

use crate::cli::Global;
use crate::connection::{Connection, Purpose, is_gone};

/// Pause before the next check whether calls have ended.
const LOOK_AGAIN: Duration = Duration::from_millis(10);

/// A farm in this process, in a neighbouring process, or on a server.
#[derive(Debug)]
pub(super) struct FarmAccess {
    global: Global,
    /// `None` after a neighbour's farm has ended, until another is opened.
    connection: Mutex<Option<Arc<Connection>>>,
    /// Cancelled when an embedded farm has ended by itself: there is nothing left to show.
    pub ended: CancellationToken,
    /// Cancelled when running calls are to end.
    closing: CancellationToken,
}

impl FarmAccess {
    pub async fn open(global: &Global) -> Result<Self> {
        let connection = Connection::open(global, Purpose::Serve).await?;
        Ok(Self {
            global: global.clone(),
            connection: Mutex::new(Some(Arc::new(connection))),
            ended: CancellationToken::new(),
            closing: CancellationToken::new(),
        })
    }

    /// The connection, opened again if necessary.
    pub async fn connection(&self) -> Result<Arc<Connection>, Status> {
        let mut connection = self.connection.lock().await;
        if let Some(connection) = &*connection {
            return Ok(Arc::clone(connection));
        }
        if self.closing.is_cancelled() {
            return Err(ending());
        }
        let opened = Connection::open(&self.global, Purpose::Serve).await;
        let opened = Arc::new(opened.map_err(|error| Status::unavailable(format!("{error:#}")))?);
        *connection = Some(Arc::clone(&opened));
        Ok(opened)
    }

    /// Forwards a call. The coordinator sees this program's token and address for every user of the page.
    pub async fn call(&self, request: Request<Body>) -> Result<Response<Body>, Status> {
        let connection = self.connection().await?;
        let mut link = connection.link();
        let answer = async {
            std::future::poll_fn(|context| link.poll_ready(context)).await?;
            link.call(for_farm(request)).await
        };
        let answer = tokio::select! {
            answer = answer => answer,
            () = self.closing.cancelled() => return Err(ending()),
        };
        match answer {
            Ok(answer) => Ok(answer),
            Err(error) => {
                let status = failure(&error, connection.address())
                    .map_or_else(|| gone(&connection), Status::unavailable);
                self.lost(&connection).await;
                Err(status)
            }
        }
    }

    /// The answer of the farm to a question of this program, which ends with the page.
    pub async fn answer<T>(
        &self,
        connection: &Arc<Connection>,
        asking: impl Future<Output = Result<T>>,
    ) -> Result<T> {
        let answer = tokio::select! {
            answer = asking => answer,
            () = self.closing.cancelled() => return Err(ending().into()),
        };
        match answer {
            Err(error) if is_gone(&error) => {
                let status = error.chain().find_map(|cause| cause.downcast_ref::<Status>());
                let reason = status.and_then(|status| failure(status, connection.address()));
                self.lost(connection).await;
                Err(reason.map_or_else(|| gone(connection), Status::unavailable).into())
            }
            answer => answer,
        }
    }

    /// Handles a lost connection. A server may return at its address; other farms do not.
    async fn lost(&self, connection: &Arc<Connection>) {
        if connection.is_embedded() {
            if connection.has_ended() {
                self.ended.cancel();
            }
        } else if !connection.is_server() {
            self.connection.lock().await.take_if(|held| Arc::ptr_eq(held, connection));
        }
    }

    /// Closes the farm if it runs in this process.
    pub async fn close(&self) -> Result<()> {
        self.closing.cancel();
        let Some(mut connection) = self.connection.lock().await.take() else { return Ok(()) };
        loop {
            match Arc::try_unwrap(connection) {
                Ok(connection) => return connection.close().await,
                // A call that was just cancelled still holds the connection.
                Err(held) => connection = held,
            }
            tokio::time::sleep(LOOK_AGAIN).await;
        }
    }
}

/// The request without headers that concern the page alone: its cookie, host and origin.
fn for_farm(request: Request<Body>) -> Request<Body> {
    let (mut parts, body) = request.into_parts();
    let kept = |name: &str| name.starts_with("grpc-") || ["content-type", "te", "user-agent"].contains(&name);
    let unwanted: Vec<_> = parts.headers.keys().filter(|name| !kept(name.as_str())).cloned().collect();
    for name in unwanted {
        parts.headers.remove(name);
    }
    // Only the path: the link contains the address.
    let path = parts.uri.path().parse().unwrap_or_else(|_| Uri::from_static("/"));
    parts.uri = path;
    parts.extensions.clear();
    Request::from_parts(parts, body)
}

fn ending() -> Status {
    Status::unavailable("farmctl web is ending")
}

fn gone(connection: &Connection) -> Status {
    Status::unavailable(format!("the farm at {} does not answer", connection.address()))
}
