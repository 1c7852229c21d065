use std::net::SocketAddr;
use std::time::Duration;

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinHandle;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

use super::snapshot::MOST_RATIOS;
use super::*;
use crate::stored::OutcomeKind;

const FIT: &str = "/farm.v1.Fits/Fit";

fn fresh() -> Metrics {
    let build = BuildInfo { version: "1.2.3".to_owned(), physics_version: "7".to_owned() };
    Metrics::new(build, [FIT, "/farm.v1.Leases/Take"])
}

fn snapshot() -> Snapshot {
    Snapshot {
        jobs: JobCounts { pending: 5, leased: 4, done: 3, failed: 2 },
        workers: WorkerCounts { working: 6, ..WorkerCounts::default() },
        dictionaries: DictionaryCounts { cancelled: 1, ..DictionaryCounts::default() },
        work_done: (0..150).map(|n| (format!("d-{n}"), f64::from(n) / 150.0)).collect(),
        database_bytes: 65_536,
        backup_age_s: Some(3600.5),
    }
}

struct Served {
    address: SocketAddr,
    stop: CancellationToken,
    task: JoinHandle<()>,
}

/// A server of these metrics that is ready.
async fn ready(metrics: Metrics) -> Served {
    start(MetricsServer::new(metrics, snapshot, || Ok(()))).await
}

async fn start(server: MetricsServer) -> Served {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let (address, stop) = (listener.local_addr().unwrap(), CancellationToken::new());
    let task = tokio::spawn(serve(listener, server, stop.clone()));
    Served { address, stop, task }
}

impl Served {
    /// A connection that has sent these bytes.
    async fn sends(&self, bytes: &str) -> TcpStream {
        let mut stream = TcpStream::connect(self.address).await.unwrap();
        stream.write_all(bytes.as_bytes()).await.unwrap();
        stream
    }

    /// Status line and headers, body.
    async fn get(&self, path: &str, headers: &str) -> (String, String) {
        let request = format!("GET {path} HTTP/1.1\r\nHost: farm\r\nConnection: close\r\n{headers}\r\n");
        let mut stream = self.sends(&request).await;
        let mut answer = String::new();
        stream.read_to_string(&mut answer).await.unwrap();
        let (head, body) = answer.split_once("\r\n\r\n").unwrap();
        (head.to_owned(), body.to_owned())
    }

    async fn metrics(&self) -> String {
        let (head, body) = self.get("/metrics", "").await;
        assert!(head.starts_with("HTTP/1.1 200 "), "{head}");
        assert!(head.contains("content-type: text/plain; version=0.0.4"), "{head}");
        body
    }
}

fn has(text: &str, line: &str) {
    assert!(text.lines().any(|there| there == line), "`{line}` is not in\n{text}");
}

/// Each event that was counted appears in the metrics.
#[tokio::test]
async fn counted_events_appear_in_metrics() {
    let metrics = fresh();
    metrics.rpc(FIT, 0, Duration::from_micros(200));
    metrics.rpc(FIT, 5, Duration::from_secs(100));
    metrics.job_completed(OutcomeKind::Duplicate);
    metrics.job_failed(JobFailure::Quarantined);
    metrics.leases_expired(2);
    metrics.leases_granted(LeaseKind::Speculative, 8);
    metrics.verified(VerificationOutcome::Disputed);
    metrics.committed(Duration::from_millis(3), 4, 36);
    metrics.connection_refused();
    metrics.access_file_unread();
    metrics.fitted(Duration::from_micros(300));
    metrics.fit_stopped();
    let served = ready(metrics.clone()).await;
    let text = served.metrics().await;
    for line in [
        r#"farm_rpc_seconds_bucket{le="0.0001",method="/farm.v1.Fits/Fit",code="OK"} 0"#,
        r#"farm_rpc_seconds_bucket{le="0.00025",method="/farm.v1.Fits/Fit",code="OK"} 1"#,
        r#"farm_rpc_seconds_bucket{le="60.0",method="/farm.v1.Fits/Fit",code="NOT_FOUND"} 0"#,
        r#"farm_rpc_seconds_bucket{le="+Inf",method="/farm.v1.Fits/Fit",code="NOT_FOUND"} 1"#,
        "# TYPE farm_jobs_completed_total counter",
        r#"farm_jobs_completed_total{outcome="stored"} 0"#,
        r#"farm_jobs_completed_total{outcome="duplicate"} 1"#,
        r#"farm_jobs_failed_total{kind="quarantined"} 1"#,
        "farm_leases_expired_total 2",
        r#"farm_leases_granted_total{kind="speculative"} 8"#,
        r#"farm_verifications_total{outcome="disputed"} 1"#,
        "farm_records_stored_total 36",
        "farm_commits_total 1",
        "farm_commit_seconds_count 1",
        r#"farm_commit_jobs_bucket{le="4.0"} 1"#,
        r#"farm_commit_jobs_bucket{le="2.0"} 0"#,
        "farm_connections_refused_total 1",
        "farm_access_file_errors_total 1",
        "farm_fit_seconds_count 1",
        "farm_fits_stopped_total 1",
        r#"farm_build_info{version="1.2.3",physics_version="7"} 1"#,
    ] {
        has(&text, line);
    }
    metrics.leases_expired(1);
    has(&served.metrics().await, "farm_leases_expired_total 3");
}

/// Gauges show the current state, of at most 100 dictionaries, and the resources of the process. Every metric has a
/// sentence of help and a type.
#[tokio::test]
async fn gauges_cover_at_most_100_dictionaries() {
    let metrics = fresh();
    metrics.rpc(FIT, 0, Duration::ZERO);
    let text = ready(metrics).await.metrics().await;
    for line in [
        r#"farm_jobs{state="pending"} 5"#,
        r#"farm_jobs{state="failed"} 2"#,
        r#"farm_workers{state="working"} 6"#,
        r#"farm_workers{state="silent"} 0"#,
        r#"farm_dictionaries{state="cancelled"} 1"#,
        r#"farm_work_done_ratio{dictionary="d-75"} 0.5"#,
        "farm_database_bytes 65536",
        "# HELP farm_database_bytes Size of the database with its log.",
        "# TYPE process_cpu_seconds_total counter",
    ] {
        has(&text, line);
    }
    assert_eq!(text.matches("\nfarm_work_done_ratio{").count(), MOST_RATIOS);
    let after = |begin: String| text.lines().find_map(|line| line.strip_prefix(&begin)).unwrap();
    #[cfg(target_os = "linux")]
    for (name, range) in [
        ("process_resident_memory_bytes", 1e6..1e12),
        ("process_open_fds", 3.0..1e6),
        ("process_cpu_seconds_total", 1e-6..1e6),
    ] {
        assert!(range.contains(&after(format!("{name} ")).parse::<f64>().unwrap()), "{name}");
    }
    let types = text.lines().filter_map(|line| line.strip_prefix("# TYPE "));
    let names: Vec<_> = types.map(|line| line.split(' ').next().unwrap()).collect();
    assert_eq!(names.len(), if cfg!(target_os = "linux") { 24 } else { 22 }, "{names:?}");
    for name in names {
        let help = after(format!("# HELP {name} "));
        let is_sentence =
            help.starts_with(char::is_uppercase) && help.ends_with('.') && !help.ends_with("..");
        assert!(is_sentence, "{name}: {help}");
    }
}

/// Calls of invented methods and codes add no metrics beyond those of `other`.
#[tokio::test]
async fn made_up_methods_add_no_metrics() {
    let metrics = fresh();
    for n in 0..1000 {
        metrics.rpc(&format!("/made.up/{n}\"\n"), n - 500, Duration::ZERO);
    }
    let served = start(MetricsServer::new(metrics, Snapshot::default, || Ok(()))).await;
    let text = served.metrics().await;
    let counts: Vec<_> = text.lines().filter(|line| line.starts_with("farm_rpc_seconds_count{")).collect();
    assert!(counts.iter().all(|line| line.contains("method=\"other\"")), "{counts:?}");
    assert_eq!(counts.len(), 17, "{counts:?}");
}

/// A request that accepts OpenMetrics is answered in that format.
#[tokio::test]
async fn open_metrics_is_served_on_request() {
    let served = ready(fresh()).await;
    let (head, body) =
        served.get("/metrics", "Accept: application/openmetrics-text;version=1.0.0,*/*\r\n").await;
    assert!(head.contains("content-type: application/openmetrics-text; version=1.0.0"), "{head}");
    has(&body, "# TYPE farm_commits counter");
    assert!(body.ends_with("# EOF\n"));
}

/// A failed readiness check gives the reason, and an unknown path is answered with a list of the paths.
#[tokio::test]
async fn health_names_reason_and_paths_are_listed() {
    let opening = MetricsServer::new(fresh(), snapshot, || Err("the database is being opened".to_owned()));
    let (ready, opening) = (ready(fresh()).await, start(opening).await);
    for (served, path, status, expected) in [
        (&opening, "/livez", 200, "ok"),
        (&opening, "/readyz", 503, "the database is being opened"),
        (&ready, "/readyz", 200, "ok"),
    ] {
        let (head, body) = served.get(path, "").await;
        assert!(head.starts_with(&format!("HTTP/1.1 {status} ")) && body == expected, "{head} {body}");
    }
    let (head, body) = ready.get("/favicon.ico", "").await;
    assert!(head.starts_with("HTTP/1.1 404 "), "{head}");
    assert!(["/metrics", "/livez", "/readyz"].iter().all(|path| body.contains(path)), "{body}");
}

/// The server stops at once, whatever is connected; idle connections do not delay that at all.
#[tokio::test]
async fn server_stops_at_once_despite_connections() {
    for (unfinished, limit) in [(false, Duration::from_millis(300)), (true, Duration::from_secs(2))] {
        let served = ready(fresh()).await;
        let _silent = if unfinished { Some(served.sends("").await) } else { None };
        let _halting =
            if unfinished { Some(served.sends("GET /livez HTTP/1.1\r\nHost:").await) } else { None };
        let mut idle = served.sends("GET /livez HTTP/1.1\r\nHost: farm\r\n\r\n").await;
        let mut answer = [0; 15];
        idle.read_exact(&mut answer).await.unwrap();
        assert_eq!(&answer, b"HTTP/1.1 200 OK");
        served.stop.cancel();
        timeout(limit, served.task).await.expect("it waits for a connection").unwrap();
        assert!(TcpStream::connect(served.address).await.is_err());
    }
}

/// Each probe is answered, even if seven hundred connections of the same address send incomplete requests, and new ones
/// when those are closed.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn probe_is_answered_despite_connections() {
    // Both ends of the connections are in this process.
    let maximum = getrlimit(Resource::Nofile).maximum;
    setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum }).unwrap();
    let served = ready(fresh()).await;
    let address = served.address;
    let mut halting = tokio::task::JoinSet::new();
    for _ in 0..700 {
        halting.spawn(async move {
            loop {
                let mut stream = TcpStream::connect(address).await.unwrap();
                stream.write_all(b"GET /livez HTTP/1.1\r\nHost:").await.unwrap();
                let _ = stream.read(&mut [0]).await;
            }
        });
    }
    for probe in 0..14 {
        let answer = timeout(Duration::from_secs(2), served.get("/livez", "")).await;
        assert_eq!(answer.expect("it waits for requests that do not arrive").1, "ok", "{probe}");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

/// A request that hangs inside its handler does not delay the stop of the server.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn hanging_answer_does_not_delay_the_stop() {
    let (entered, inside) = std::sync::mpsc::channel();
    let (leave, left) = std::sync::mpsc::channel::<()>();
    let left = std::sync::Mutex::new(left);
    let hang = move || {
        entered.send(()).unwrap();
        let _ = left.lock().unwrap().recv();
        Snapshot::default()
    };
    let served = start(MetricsServer::new(fresh(), hang, || Ok(()))).await;
    let _waits = served.sends("GET /metrics HTTP/1.1\r\nHost: farm\r\n\r\n").await;
    tokio::task::spawn_blocking(move || inside.recv().unwrap()).await.unwrap();
    served.stop.cancel();
    timeout(Duration::from_secs(2), served.task).await.expect("it waits for the answer").unwrap();
    drop(leave);
}
