//! Injects network faults by a proxy: bytes pass, are silently held back, or the connection is cut.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinHandle;

/// The direction of bytes: to the server, or back.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    Requests,
    Answers,
}

/// Treatment of the bytes of one direction. Held bytes are delivered in order when the direction passes again, as lost
/// packets are by retransmission.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Rule {
    Pass,
    Hold,
    /// This many further bytes of each connection pass, then all are held.
    PassThenHold(u64),
}

#[derive(Debug, Clone, Copy)]
struct Rules {
    requests: Rule,
    answers: Rule,
    /// Connections with lower numbers are cut.
    cut_before: u64,
    /// Connections with lower numbers are held for ever, as by a router that has lost their state.
    frozen_before: u64,
}

/// A loopback port that forwards to another one.
#[derive(Debug)]
pub struct Proxy {
    address: SocketAddr,
    rules: Arc<watch::Sender<Rules>>,
    accepted: Arc<AtomicU64>,
    held_bytes: Arc<AtomicU64>,
    task: JoinHandle<()>,
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.task.abort();
        self.cut();
    }
}

impl Proxy {
    /// Opens a port that forwards to `target`, which need not listen yet.
    ///
    /// # Panics
    /// If no port can be opened.
    pub async fn start(target: SocketAddr) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port on loopback");
        let address = listener.local_addr().expect("it has an address");
        let rules = Rules { requests: Rule::Pass, answers: Rule::Pass, cut_before: 0, frozen_before: 0 };
        let rules = Arc::new(watch::channel(rules).0);
        let (accepted, held_bytes) = (Arc::<AtomicU64>::default(), Arc::<AtomicU64>::default());
        let task =
            tokio::spawn(accept(listener, target, rules.clone(), accepted.clone(), held_bytes.clone()));
        Self { address, rules, accepted, held_bytes, task }
    }

    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Number of connections so far.
    pub fn accepted(&self) -> u64 {
        self.accepted.load(Ordering::SeqCst)
    }

    /// Bytes that are currently held back.
    pub fn held_bytes(&self) -> u64 {
        self.held_bytes.load(Ordering::SeqCst)
    }

    /// Holds a direction back without any error at either end.
    pub fn hold(&self, direction: Direction) {
        self.set(direction, Rule::Hold);
    }

    /// Holds a direction back after this many further bytes of each connection.
    pub fn hold_after(&self, direction: Direction, bytes: u64) {
        self.set(direction, Rule::PassThenHold(bytes));
    }

    /// Lets both directions pass again, beginning with the held bytes.
    pub fn heal(&self) {
        self.set(Direction::Requests, Rule::Pass);
        self.set(Direction::Answers, Rule::Pass);
    }

    /// Holds the existing connections for ever; later ones pass.
    pub fn freeze(&self) {
        let accepted = self.accepted();
        self.rules.send_modify(|rules| rules.frozen_before = accepted);
    }

    /// Cuts the existing connections and drops their held bytes; later ones follow the rules.
    pub fn cut(&self) {
        let accepted = self.accepted();
        self.rules.send_modify(|rules| rules.cut_before = accepted);
    }

    fn set(&self, direction: Direction, rule: Rule) {
        self.rules.send_modify(|rules| match direction {
            Direction::Requests => rules.requests = rule,
            Direction::Answers => rules.answers = rule,
        });
    }
}

async fn accept(
    listener: TcpListener,
    target: SocketAddr,
    rules: Arc<watch::Sender<Rules>>,
    accepted: Arc<AtomicU64>,
    held_bytes: Arc<AtomicU64>,
) {
    while let Ok((client, _)) = listener.accept().await {
        let number = accepted.fetch_add(1, Ordering::SeqCst);
        let (rules, held_bytes) = (rules.subscribe(), held_bytes.clone());
        tokio::spawn(async move {
            // Without a target, the connection is closed.
            let Ok(server) = TcpStream::connect(target).await else { return };
            let _ = (client.set_nodelay(true), server.set_nodelay(true));
            let ((from_client, to_client), (from_server, to_server)) =
                (client.into_split(), server.into_split());
            let pump =
                |direction| Pump { number, direction, rules: rules.clone(), held_bytes: held_bytes.clone() };
            // When one direction ends, both halves are dropped, which ends the other.
            tokio::select! {
                () = pump(Direction::Requests).run(from_client, to_server) => {}
                () = pump(Direction::Answers).run(from_server, to_client) => {}
            }
        });
    }
}

/// One direction of one connection.
struct Pump {
    number: u64,
    direction: Direction,
    rules: watch::Receiver<Rules>,
    held_bytes: Arc<AtomicU64>,
}

impl Pump {
    async fn run(mut self, mut from: impl AsyncRead + Unpin, mut to: impl AsyncWrite + Unpin) {
        let mut buffer = vec![0; 64 << 10];
        // Held bytes, how many of them are counted in `held_bytes`, and how many passed since the rule was set.
        let (mut held, mut counted, mut passed, mut last) = (Vec::<u8>::new(), 0, 0_u64, Rule::Pass);
        loop {
            let rules = *self.rules.borrow_and_update();
            if self.number < rules.cut_before {
                break;
            }
            let rule = self.rule(rules);
            if rule != last {
                (last, passed) = (rule, 0);
            }
            let room = match rule {
                Rule::Pass => u64::MAX,
                Rule::Hold => 0,
                Rule::PassThenHold(bytes) => bytes - passed,
            };
            let now = held.len().min(usize::try_from(room).unwrap_or(usize::MAX));
            if now > 0 {
                if to.write_all(&held[..now]).await.is_err() {
                    break;
                }
                held.drain(..now);
                passed += now as u64;
            }
            // Only bytes that stay here count, not those that pass through.
            self.held_bytes.fetch_sub(counted, Ordering::SeqCst);
            counted = held.len() as u64;
            self.held_bytes.fetch_add(counted, Ordering::SeqCst);
            tokio::select! {
                changed = self.rules.changed() => if changed.is_err() { break },
                read = from.read(&mut buffer) => match read {
                    Ok(bytes) if bytes > 0 => held.extend_from_slice(&buffer[..bytes]),
                    // The end of a connection is held back as well.
                    _ if self.holds() => while self.holds() {
                        if self.rules.changed().await.is_err() { break }
                    },
                    _ => break,
                },
            }
        }
        self.held_bytes.fetch_sub(counted, Ordering::SeqCst);
    }

    fn rule(&self, rules: Rules) -> Rule {
        match self.direction {
            _ if self.number < rules.frozen_before => Rule::Hold,
            Direction::Requests => rules.requests,
            Direction::Answers => rules.answers,
        }
    }

    fn holds(&self) -> bool {
        let rules = *self.rules.borrow();
        self.number >= rules.cut_before && self.rule(rules) == Rule::Hold
    }
}
