//! Connections within the process, without sockets, so that tests may pause the clock.

use std::io;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use tokio::io::{DuplexStream, copy_bidirectional, duplex};
use tokio::sync::mpsc;
use tokio::task::AbortHandle;

const BUFFER_BYTES: usize = 1 << 16;

#[derive(Debug)]
pub(super) struct Network {
    listener: mpsc::UnboundedSender<io::Result<DuplexStream>>,
    down: AtomicBool,
    connections: Mutex<Vec<AbortHandle>>,
}

impl Network {
    /// A network, and the connections that arrive at its only server.
    pub(super) fn new() -> (Self, mpsc::UnboundedReceiver<io::Result<DuplexStream>>) {
        let (listener, incoming) = mpsc::unbounded_channel();
        (Self { listener, down: AtomicBool::new(false), connections: Mutex::default() }, incoming)
    }

    /// The client's end of a new connection.
    pub(super) fn connect(&self) -> io::Result<DuplexStream> {
        if self.down.load(Ordering::SeqCst) {
            return Err(io::ErrorKind::ConnectionRefused.into());
        }
        let (client, mut near) = duplex(BUFFER_BYTES);
        let (mut far, server) = duplex(BUFFER_BYTES);
        let wire = tokio::spawn(async move {
            let _ = copy_bidirectional(&mut near, &mut far).await;
        });
        self.connections.lock().unwrap().push(wire.abort_handle());
        self.listener.send(Ok(server)).map_err(|_| io::ErrorKind::ConnectionRefused)?;
        Ok(client)
    }

    /// Cuts all connections without notice to either side.
    pub(super) fn cut(&self) {
        self.connections.lock().unwrap().drain(..).for_each(|wire| wire.abort());
    }

    /// Cuts all connections and refuses new ones, or accepts them again.
    pub(super) fn set_down(&self, down: bool) {
        self.down.store(down, Ordering::SeqCst);
        if down {
            self.cut();
        }
    }
}
