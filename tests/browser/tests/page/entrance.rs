//! Access to the page: deep links, proxies, and requests without a token or from other sites.

use std::sync::{Arc, Mutex};

use axum::Router;
use axum::extract::Request;
use axum::response::Html;
use farm_browser_tests::browser::{self, Browser, OTHER_NAME};
use farm_browser_tests::reverse_proxy::ReverseProxy;
use farm_proto::wire::SubmitRequest;
use farm_tests::grids::grid_of;
use farm_tests::page::Page;
use farm_tests::process::free_port;
use prost::Message as _;
use serde_json::{Value, json};
use thirtyfour::By;
use tokio::net::TcpListener;

use super::{GRID, folder_with_dictionary, go_to, let_in, measure_the_example};

/// A deep link into a page without state shows the view it was copied from.
#[tokio::test(flavor = "multi_thread")]
async fn deep_link_restores_its_view() {
    if !browser::is_there() {
        return;
    }
    let folder = folder_with_dictionary();
    let page = Page::start(folder.path(), &[]);
    let browser = let_in(&page).await;
    let link = format!(
        "{}#/dictionary?name=coarse&sigma_t=8.5&albedo=0.9993&g=0.45&thickness=1&channel=B",
        page.home
    );
    // From another address, so that the page has no state.
    browser.open("about:blank").await;
    browser.open(&link).await;
    browser.shows("between records").await;
    let line = browser.css("section[aria-label=Profile] code").await.text().await.unwrap();
    assert_eq!(
        line,
        "farmctl profile --sigma-t 8.5 --albedo 0.9993 --g 0.45 --thickness 1 --channel B --plot profile.svg"
    );
    // Invalid values in a link are clamped.
    browser.open("about:blank").await;
    browser
        .open(&format!("{}#/dictionary?sigma_t=1e9&albedo=x&g=-7&thickness=&channel=%3Cb%3E", page.home))
        .await;
    browser.shows("± ").await;
    let line = browser.css("section[aria-label=Profile] code").await.text().await.unwrap();
    assert!(
        line.contains("--sigma-t 28 ") && line.contains("--g 0.2 ") && line.contains("--channel R,G,B "),
        "{line}"
    );
    assert_eq!(browser.complaints().await, Vec::<String>::new());
    browser.end().await;
}

/// Behind a proxy with a path prefix, everything works the same.
#[tokio::test(flavor = "multi_thread")]
async fn prefix_proxy_changes_nothing() {
    if !browser::is_there() {
        return;
    }
    let folder = folder_with_dictionary();
    let listen = format!("127.0.0.1:{}", free_port());
    let proxy = ReverseProxy::start(&listen, "user/ada/resins").await;
    let behind = format!("http://{}/user/ada/resins/", proxy.address);
    let page = Page::start_at(folder.path(), &listen, &["--behind", &behind]);
    assert!(page.home.starts_with(&behind), "{}", page.home);
    let browser = let_in(&page).await;
    measure_the_example(&browser).await;
    go_to(&browser, "Farm").await;
    // The stream of states passes too.
    browser.shows("36 done").await;
    assert_eq!(browser.complaints().await, Vec::<String>::new());
    browser.end().await;
}

/// Without the token, or from another site, access is refused.
#[tokio::test(flavor = "multi_thread")]
async fn page_needs_token_and_same_site() {
    if !browser::is_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let page = Page::start(folder.path(), &[]);
    let browser = Browser::start().await;
    for address in [
        page.home.clone(),
        format!("{}?token=wrong", page.home),
        format!("http://{}/", page.host),
        page.url().replace("127.0.0.1", OTHER_NAME),
    ] {
        browser.open(&address).await;
        browser.shows("Access denied").await;
    }
    browser.complaints().await;
    browser.open(&page.url()).await;
    browser.shows("Choose a measurement").await;

    // Another user's server on this machine, which the same browser visits.
    let cookies_received: Arc<Mutex<Vec<String>>> = Arc::default();
    let other = listen_elsewhere(Arc::clone(&cookies_received)).await;
    browser.open(&format!("http://127.0.0.1:{other}/")).await;
    browser.element(By::Id("other")).await;
    let cookies_received = cookies_received.lock().unwrap().clone();
    assert!(
        !cookies_received.is_empty() && cookies_received.iter().all(|cookie| !cookie.contains(&page.token)),
        "{cookies_received:?}"
    );
    for (how, credentials) in [("cors", "include"), ("no-cors", "include"), ("cors", "omit")] {
        let response = submitted_from_here(&browser, &page, how, credentials).await;
        assert!(response == "refused" || response == "opaque 0", "{how}, {credentials}: {response}");
    }
    // Nothing was submitted; from the page itself the same call succeeds.
    browser.open(&format!("{}#/farm", page.home)).await;
    browser.shows("There is none yet").await;
    assert_eq!(submitted_from_here(&browser, &page, "same-origin", "include").await, "basic 200");
    browser.shows("unwanted").await;
    // Another site cannot show the page in a frame.
    browser.open(&format!("http://127.0.0.1:{other}/")).await;
    let framed = format!(
        "const [done] = arguments; const frame = document.createElement('iframe'); frame.src = {}; \
         frame.onload = () => done('loaded'); document.body.append(frame);",
        json!(page.home)
    );
    browser.driver.execute_async(&framed, vec![]).await.unwrap();
    browser.driver.enter_frame(0).await.unwrap();
    let within = browser.shown().await;
    // The navigation is part of the first rendering.
    assert!(!within.contains("Measure"), "{within}");
    browser.end().await;
}

/// A site on another port of this machine, which records the cookies that it receives.
async fn listen_elsewhere(cookies_received: Arc<Mutex<Vec<String>>>) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = listener.local_addr().unwrap().port();
    let routes = Router::new().fallback(move |request: Request| {
        let cookies = request.headers().get("cookie").map(|value| value.to_str().unwrap().to_owned());
        cookies_received.lock().unwrap().push(cookies.unwrap_or_default());
        async { Html("<!doctype html><title>other</title><p id=other>another site</p>") }
    });
    tokio::spawn(async move { axum::serve(listener, routes).await });
    port
}

/// The response to a script that submits a dictionary.
async fn submitted_from_here(browser: &Browser, page: &Page, mode: &str, credentials: &str) -> Value {
    let script = "const [url, bytes, mode, credentials, done] = arguments; \
                  fetch(url, { method: 'POST', mode, credentials, body: new Uint8Array(bytes), \
                  headers: mode === 'no-cors' ? {} : { 'content-type': 'application/grpc-web+proto' } }) \
                  .then((r) => done(`${r.type} ${r.status}`), () => done('refused'));";
    let grid = Some((&grid_of(GRID)).into());
    let message = SubmitRequest { name: "unwanted".to_owned(), grid, priority: 0 }.encode_to_vec();
    let framed = [&[0], &(message.len() as u32).to_be_bytes()[..], &message].concat();
    let url = format!("{}farm.v1.Dictionaries/Submit", page.home);
    let arguments = vec![json!(url), json!(framed), json!(mode), json!(credentials)];
    browser.driver.execute_async(script, arguments).await.unwrap().json().clone()
}
