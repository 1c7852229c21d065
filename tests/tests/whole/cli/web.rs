//! The server of `farmctl web`: access control, questions as JSON, and the calls that it passes to the farm.

use std::collections::HashMap;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;

use farm_proto::wire;
use farm_tests::page::Page;
use farm_tests::process::{LONG, SOON, run, wait_for};
use farm_tests::reference::root;
use prost::Message;
use serde_json::{Value, json};
use wire::DictionaryState;

const GRID: &str = "sigma_t_per_mm = [4, 8]\nalbedo = [0.9, 0.999]\ng = [0.0, 0.4]\nwalks = 2000\n";

/// The page's server for a folder.
struct PageServer {
    folder: tempfile::TempDir,
    page: Page,
}

/// Status, headers and body of an answer.
struct Answer {
    status: u16,
    headers: HashMap<String, String>,
    body: Vec<u8>,
}

impl PageServer {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let session = folder.path().join("session");
        std::fs::create_dir(&session).unwrap();
        for name in ["report.html", "session.json"] {
            std::fs::write(session.join(name), name).unwrap();
        }
        std::fs::write(folder.path().join("secret.json"), "secret").unwrap();
        let page = Page::start(folder.path(), &[]);
        Self { folder, page }
    }

    /// A request with these headers; `host` comes first.
    fn send(&self, host: &str, method: &str, path: &str, headers: &[(&str, &str)], body: &[u8]) -> Answer {
        let mut stream = TcpStream::connect(&self.page.host).unwrap();
        stream.set_read_timeout(Some(SOON)).unwrap();
        // HTTP/1.0: the answer is not chunked, and ends with the connection.
        let mut request = format!("{method} {path} HTTP/1.0\r\nhost: {host}\r\n");
        for (name, value) in headers {
            request += &format!("{name}: {value}\r\n");
        }
        request += &format!("content-length: {}\r\n\r\n", body.len());
        stream.write_all(&[request.as_bytes(), body].concat()).unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        let end = answer.windows(4).position(|w| w == b"\r\n\r\n").unwrap();
        let head = String::from_utf8(answer[..end].to_vec()).unwrap();
        let (status, headers) = head.split_once("\r\n").unwrap();
        let pair = |line: &str| line.split_once(": ").map(|(k, v)| (k.to_ascii_lowercase(), v.to_owned()));
        Answer {
            status: status.split(' ').nth(1).unwrap().parse().unwrap(),
            headers: headers.lines().filter_map(pair).collect(),
            body: answer[end + 4..].to_vec(),
        }
    }

    /// A path in the page's folder.
    fn at(&self, path: &str) -> String {
        format!("{}{path}", self.page.folder)
    }

    fn cookie(&self) -> String {
        format!("farm={}", self.page.token)
    }

    fn get(&self, path: &str) -> Answer {
        self.send(&self.page.host, "GET", &self.at(path), &[("cookie", &self.cookie())], b"")
    }

    /// A call as the page makes it: the answer's messages, or status code and message.
    fn call<A: Message + Default>(
        &self,
        method: &str,
        request: &impl Message,
    ) -> Result<Vec<A>, (u32, String)> {
        let (cookie, origin) = (self.cookie(), format!("http://{}", self.page.host));
        let headers = [
            ("cookie", cookie.as_str()),
            ("origin", &origin),
            ("content-type", "application/grpc-web+proto"),
            ("x-grpc-web", "1"),
        ];
        let answer = self.send(&self.page.host, "POST", &self.at(method), &headers, &framed(request));
        assert_eq!(answer.status, 200, "{method}");
        let mut messages = Vec::new();
        let mut trailers = answer.headers;
        let mut rest = answer.body.as_slice();
        while let [flag, a, b, c, d, after @ ..] = rest {
            let (frame, after) = after.split_at(u32::from_be_bytes([*a, *b, *c, *d]) as usize);
            if flag & 0x80 == 0 {
                messages.push(A::decode(frame).unwrap());
            } else {
                let text = String::from_utf8(frame.to_vec()).unwrap();
                let pairs = text.lines().filter_map(|line| line.split_once(':'));
                trailers.extend(pairs.map(|(k, v)| (k.to_owned(), v.trim().to_owned())));
            }
            rest = after;
        }
        match trailers["grpc-status"].parse().unwrap() {
            0 => Ok(messages),
            code => Err((code, trailers.get("grpc-message").cloned().unwrap_or_default())),
        }
    }

    /// Status and answer of a question.
    fn question(&self, verb: &str, inputs: &Value) -> (u16, Value) {
        let (cookie, origin) = (self.cookie(), format!("http://{}", self.page.host));
        let headers = [("cookie", cookie.as_str()), ("origin", &origin)];
        let path = self.at(&format!("ask/{verb}"));
        let answer = self.send(&self.page.host, "POST", &path, &headers, inputs.to_string().as_bytes());
        (answer.status, serde_json::from_slice(&answer.body).unwrap())
    }

    fn ask<A: Message + Default>(&self, method: &str, request: &impl Message) -> A {
        let mut answers = self.call(method, request).unwrap_or_else(|e| panic!("{method}: {e:?}"));
        assert_eq!(answers.len(), 1);
        answers.pop().unwrap()
    }
}

fn framed(message: &impl Message) -> Vec<u8> {
    let bytes = message.encode_to_vec();
    let mut frame = vec![0];
    frame.extend((bytes.len() as u32).to_be_bytes());
    frame.extend(bytes);
    frame
}

const STATUS: &str = "farm.v1.Farm/Status";

/// The page admits requests with its address and its token only. Which those are, unit tests of its gate prove.
#[test]
fn page_admits_only_its_own_address() {
    let server = PageServer::start();
    let own = server.page.host.as_str();
    let entrance = server.at(&format!("?token={}", server.page.token));
    let let_in = server.send(own, "GET", &entrance, &[], b"");
    assert_eq!((let_in.status, let_in.headers["location"].as_str()), (303, "./"));
    assert!(let_in.headers["set-cookie"].starts_with(&server.cookie()), "{}", let_in.headers["set-cookie"]);
    let html = server.get("");
    assert_eq!(html.status, 200);
    assert!(html.headers["content-security-policy"].starts_with("default-src 'none'; script-src 'self'"));
    assert!(String::from_utf8(html.body).unwrap().contains("./page.js"));
    assert_eq!(server.get("page.js").status, 200);
    assert_eq!(server.get("captures/0/report.html").body, b"report.html");
    let outside = ["captures/0/..%2fsecret.json", "captures/0/../secret.json", "captures/1/report.html"];
    for path in outside.into_iter().chain(["nothing", "secret.json", "farm.v1.Leases/Acquire"]) {
        assert_eq!(server.get(path).status, 404, "{path}");
    }

    // The tests of `client/src/commands/web/gate.rs` have all ways to be refused; here each has its status.
    let cookie = server.cookie();
    let (cookie, kind) = (("cookie", cookie.as_str()), ("content-type", "application/grpc-web+proto"));
    let (origin, body) = (format!("http://{own}"), framed(&wire::StatusRequest {}));
    let (origin, status) = (("origin", origin.as_str()), server.at(STATUS));
    for (code, host, headers) in [
        (200, own, [cookie, kind, origin]),
        (401, own, [("cookie", "farm=1"), kind, origin]),
        (403, own, [cookie, kind, ("origin", "http://evil.example")]),
        (421, "evil.example", [cookie, kind, origin]),
        (400, own, [cookie, ("content-type", "application/json"), origin]),
    ] {
        assert_eq!(server.send(host, "POST", &status, &headers, &body).status, code, "{host} {headers:?}");
    }
    // Paths outside of the page's prefix are refused.
    for path in ["/", "/page.js", "/folder/", &format!("/{STATUS}"), server.page.folder.trim_end_matches('/')]
    {
        assert_eq!(server.send(own, "GET", path, &[cookie], b"").status, 401, "{path}");
    }
    // Other addresses than loopback need a proxy.
    let refused = run(server.folder.path(), &["web", "--no-browser", "--listen", "0.0.0.0:0"]);
    assert_eq!(refused.code, 1);
    assert!(refused.stderr.contains("--behind"), "{}", refused.stderr);
}

/// The inputs of a verb give the answer that the command prints; an error has a status, and the field of a wrong input.
#[test]
fn questions_have_the_answers_of_commands() {
    let server = PageServer::start();
    let white = root().join("examples/white.csv");
    let printed = run(server.folder.path(), &["check", white.to_str().unwrap(), "--json"]);
    let printed: Value = serde_json::from_str(&printed.stdout).unwrap();
    assert_eq!(server.question("check", &json!({})), (200, printed));
    for (verb, inputs, code, field, message) in [
        ("grid", json!({ "built_in": "moon" }), 400, json!("built_in"), "moon"),
        ("check", json!({ "file": { "name": "a.csv", "base64": "?" } }), 400, json!("file.base64"), "a.csv"),
        ("simulate", json!({}), 400, Value::Null, "missing field `dictionary`"),
        ("capture", json!({ "session": "../a.toml", "folder": "a" }), 400, json!("session"), "../a.toml"),
        ("open", json!({ "capture": ".." }), 404, Value::Null, "no such folder"),
        ("measure", json!({ "kept": "0123456789abcdef" }), 404, Value::Null, "does not exist"),
        ("measure", json!({ "g": "0.4..x" }), 400, Value::Null, "\"x\" is not a number"),
        ("nothing", json!({}), 404, Value::Null, "nothing"),
    ] {
        let (status, answer) = server.question(verb, &inputs);
        assert_eq!((status, &answer["field"]), (code, &field), "{verb}: {answer}");
        assert!(answer["error"].as_str().unwrap().contains(message), "{verb}: {answer}");
    }
    let elsewhere = server.send(
        &server.page.host,
        "POST",
        &server.at("ask/about"),
        &[("cookie", &server.cookie())],
        b"{}",
    );
    assert_eq!(elsewhere.status, 403, "a question without the page's origin");
}

/// From an empty folder, a dictionary can be submitted and its jobs watched.
#[test]
fn empty_folder_becomes_a_watched_dictionary() {
    let mut server = PageServer::start();
    let status: wire::StatusResponse = server.ask(STATUS, &wire::StatusRequest {});
    assert_eq!(status.dictionaries, 0);
    std::fs::write(server.folder.path().join("grid.toml"), GRID).unwrap();
    let grid = farmctl_grid(server.folder.path());
    let name = "grid".to_owned();
    let submit = wire::SubmitRequest { name: name.clone(), grid: Some(grid), priority: 0 };
    let submitted: wire::Dictionary = server.ask("farm.v1.Dictionaries/Submit", &submit);
    assert_eq!(submitted.jobs_total, 8);
    // The stream ends with the dictionary.
    let watch = wire::WatchJobsRequest { name: name.clone() };
    let runs: Vec<wire::JobStates> = server.call("farm.v1.Dictionaries/WatchJobs", &watch).unwrap();
    let mut states = vec![0; 8];
    for run in &runs {
        states[run.first as usize..][..run.states.len()].copy_from_slice(&run.states);
    }
    assert_eq!(runs[0].states.len(), 8, "all states come first");
    assert_eq!(states, [wire::JobState::Done as u8; 8]);
    let done: wire::Dictionary = wait_for("the dictionary is done", LONG, || {
        let got: wire::Dictionary =
            server.ask("farm.v1.Dictionaries/Get", &wire::GetRequest { name: name.clone() });
        (got.state() == DictionaryState::Done).then_some(got)
    });
    assert_eq!(done.records_done, 16);
    let pace: wire::PaceResponse = server.ask("farm.v1.Farm/Pace", &wire::PaceRequest {});
    assert_eq!(pace.periods.iter().map(|p| p.jobs).sum::<u32>(), 8);
    // Another farmctl uses the same farm.
    let listed = run(server.folder.path(), &["list", "--json"]);
    assert!(listed.stdout.contains(&done.records_digest), "{}", listed.stdout);
    // Errors have the coordinator's message.
    let missing = wire::GetRequest { name: "nothing".to_owned() };
    let (code, message) = server.call::<wire::Dictionary>("farm.v1.Dictionaries/Get", &missing).unwrap_err();
    assert_eq!(code, tonic::Code::NotFound as u32);
    assert!(message.contains("nothing"), "{message}");
    assert_eq!(server.page.process.terminate(SOON), 0);
    // After a restart, everything is read from the disk.
    server.page = Page::start(server.folder.path(), &[]);
    let again: wire::Dictionary = server.ask("farm.v1.Dictionaries/Get", &wire::GetRequest { name });
    assert_eq!(again.records_digest, done.records_digest);
}

/// The grid of a file, as `farmctl submit` would send it.
fn farmctl_grid(folder: &Path) -> wire::Grid {
    (&farm_lab::grid_file::read_grid(&folder.join("grid.toml")).unwrap()).into()
}
