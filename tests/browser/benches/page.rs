//! Measures the speed and cost of the page: the paper's dictionary in a headless browser.
//!
//! `cargo bench -p farm-browser-tests --bench page` computes the dictionary first, or takes the one in the folder that
//! `FARM_BENCH_FOLDER` names; with `-- tabs` only the cost of tabs is measured. Frame times are measured between
//! consecutive frames of the browser while a slider or the crosshair moves once per frame. A frame shows an answer of
//! the server if its picture has changed.

#![expect(
    clippy::unwrap_used,
    clippy::disallowed_methods,
    reason = "a benchmark may panic, and measures real time"
)]

use std::path::PathBuf;
use std::time::{Duration, Instant};

use farm_browser_tests::browser::{self, Browser};
use farm_tests::farm::Farm;
use farm_tests::page::Page;
use farm_tests::process::{LONG, Process, run};
use serde_json::{Value, json};
use thirtyfour::By;

/// Moves of a slider that are timed.
const MOVES: u32 = 240;
/// Number of tabs that display a farm.
const TABS: usize = 20;
/// Duration over which their cost is measured.
const WATCHED: Duration = Duration::from_secs(20);

#[tokio::main]
async fn main() {
    if !browser::is_there() {
        return;
    }
    if std::env::args().any(|word| word == "tabs") {
        return tabs().await;
    }
    let (folder, _kept) = folder();
    let page = Page::start(&folder, &[]);
    let browser = Browser::start().await;
    println!("browser: {}", browser.order("Browser.getVersion", json!({})).await["product"]);
    first_paint(&browser, &page).await;
    dictionary(&browser, &page).await;
    measure(&browser, &page).await;
    browser.end().await;
    drop(page);
    tabs().await;
}

/// A folder with the paper's dictionary.
fn folder() -> (PathBuf, Option<tempfile::TempDir>) {
    if let Some(folder) = std::env::var_os("FARM_BENCH_FOLDER") {
        return (folder.into(), None);
    }
    let folder = tempfile::tempdir().unwrap();
    let started = Instant::now();
    let submitted = run(folder.path(), &["submit", "-q"]);
    assert_eq!(submitted.code, 0, "{}", submitted.stderr);
    println!("the paper's dictionary: {:.1} s", started.elapsed().as_secs_f64());
    (folder.path().to_owned(), Some(folder))
}

async fn first_paint(browser: &Browser, page: &Page) {
    browser.open(&page.url()).await;
    browser.shows("Choose a measurement").await;
    let mut times = Vec::new();
    for _ in 0..11 {
        browser.order("Network.clearBrowserCache", json!({})).await;
        browser.open("about:blank").await;
        browser.open(&page.home).await;
        browser.shows("Choose a measurement").await;
        let paint = "return performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? null";
        let measured =
            browser.wait("a first paint", LONG, async |b| b.script(paint, vec![]).await.as_f64()).await;
        times.push(measured);
    }
    println!("first paint, nothing cached: {}", Spread::of(times));
    let bytes = "return performance.getEntriesByType('resource').reduce((sum, e) => sum + e.transferSize, 0)";
    println!("transferred: {} bytes", browser.script(bytes, vec![]).await);
}

async fn dictionary(browser: &Browser, page: &Page) {
    browser.open("about:blank").await;
    browser.open(&format!("{}#/dictionary", page.home)).await;
    browser.shows("± ").await;
    for (slider, name) in [("σ_t [1/mm]", "σ_t"), ("α", "α"), ("g", "g"), ("thickness [mm]", "thickness")]
    {
        let measured = drag(browser, slider, "section[aria-label=Profile] canvas").await;
        println!("dictionary, {name} dragged: {measured}");
    }
}

async fn measure(browser: &Browser, page: &Page) {
    browser.open(&format!("{}#/measure", page.home)).await;
    browser.press("Try the example").await;
    browser.shows("white (R, G, B at 0.5, 1 mm)").await;
    let started = Instant::now();
    browser.press("Measure").await;
    browser.shows("Intervals of 95 %").await;
    println!("the example is measured and shown in {:.2} s", started.elapsed().as_secs_f64());
    browser.css("section[aria-label=Explore] canvas.cells").await;
    browser.css("section[aria-label=Explore] .u-over").await;
    let map = "section[aria-label=Explore] canvas.cells";
    println!("measure, μ dragged over residuals: {}", drag(browser, "scale factor", map).await);
    browser.pick("section[aria-label=Explore] .by select", "paper").await;
    for (slider, name, shown) in [
        ("σ_t [1/mm]", "crosshair along σ_t", ".u-wrap canvas"),
        ("α", "crosshair along α", ".u-wrap canvas"),
        ("g of the map", "g", "canvas.cells"),
        ("weight of gradients", "λ", "canvas.cells"),
        ("scale factor", "μ", "canvas.cells"),
    ] {
        let measured = drag(browser, slider, &format!("section[aria-label=Explore] {shown}")).await;
        println!("measure, {name} dragged: {measured}");
    }
}

/// Moves a slider back and forth, once a frame.
async fn drag(browser: &Browser, slider: &str, canvas: &str) -> String {
    let arguments = vec![json!(slider), json!(canvas), json!(MOVES)];
    let measured = browser.driver.execute_async(DRAG, arguments).await.unwrap();
    let times = |what: &str| {
        let times = measured.json()[what].as_array().unwrap();
        Spread::of(times.iter().filter_map(Value::as_f64).collect())
    };
    format!("frames {}; pictures {}; answers {}", times("frames"), times("pictures"), times("answers"))
}

/// Frames: times between frames. Pictures: times between frames with a changed canvas. Answers: times from a move after
/// a pause until the picture has changed.
const DRAG: &str = r"
const [label, selector, moves, done] = arguments;
const input = [...document.querySelectorAll('label')].find((l) => l.innerText.trim().startsWith(label))
  .querySelector('input');
const canvas = document.querySelector(selector);
const small = new OffscreenCanvas(64, 32).getContext('2d', { willReadFrequently: true });
const look = () => {
  small.clearRect(0, 0, 64, 32);
  small.drawImage(canvas, 0, 0, 64, 32);
  return small.getImageData(0, 0, 64, 32).data.reduce((h, v) => (h * 31 + v) | 0, 7);
};
const [low, high] = [Number(input.min), Number(input.max)];
const move = (share) => {
  input.value = String(Math.round(low + share * (high - low)));
  input.dispatchEvent(new Event('input', { bubbles: true }));
};
const next = () => new Promise((resolve) => requestAnimationFrame(resolve));
(async () => {
  const [frames, pictures, answers] = [[], [], []];
  move(0.3);
  for (let i = 0; i < 30; i++) await next();
  let [last, seen, drawn] = [await next(), look(), performance.now()];
  for (let i = 0; i < moves; i++) {
    move(0.5 - 0.35 * Math.cos((2 * Math.PI * i) / 120));
    const now = await next();
    frames.push(now - last);
    last = now;
    const picture = look();
    if (picture !== seen) {
      pictures.push(now - drawn);
      [seen, drawn] = [picture, now];
    }
  }
  for (let i = 0; i < 15; i++) {
    for (let k = 0; k < 40; k++) await next();
    seen = look();
    const started = performance.now();
    move(i % 2 ? 0.35 : 0.62);
    for (let k = 0; k < 120 && look() === seen; k++) await next();
    if (look() !== seen) answers.push(performance.now() - started);
  }
  done({ frames, pictures, answers });
})();
";

/// Cost of a coordinator with tabs that watch it, idle and at work.
async fn tabs() {
    let farm = Farm::start(&[]);
    let _worker = farm.worker("one", &[]);
    let cost = |what: &str, before: f64| {
        let share = (farm.coordinator().usage().unwrap().cpu_s - before) / WATCHED.as_secs_f64();
        println!("coordinator, {what}: {:.2} % of a core", 100.0 * share);
    };
    let cpu = |process: &Process| process.usage().unwrap().cpu_s;
    let grid = |seed: u32| {
        let file = farm.path(&format!("g{seed}.toml"));
        std::fs::write(&file, format!("g = [0.4]\nwalks = 1000000\nseed = {seed}\n")).unwrap();
        let name = format!("g{seed}");
        let ran = farm.farmctl(&["submit", file.to_str().unwrap(), "--name", &name]);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
    };
    let before = cpu(farm.coordinator());
    tokio::time::sleep(WATCHED).await;
    cost("no tab, at rest", before);
    grid(1);
    let before = cpu(farm.coordinator());
    tokio::time::sleep(WATCHED).await;
    cost("no tab, a dictionary", before);
    let _ = farm.farmctl(&["cancel", "g1"]);
    let page = Page::start(farm.folder(), &["--server", &farm.url()]);
    let browsers = watching(&page).await;
    let before = (cpu(farm.coordinator()), cpu(&page.process));
    tokio::time::sleep(WATCHED).await;
    cost(&format!("{TABS} tabs, at rest"), before.0);
    let web = (cpu(&page.process) - before.1) / WATCHED.as_secs_f64();
    println!("farmctl web, {TABS} tabs, at rest: {:.2} % of a core", 100.0 * web);
    grid(2);
    let before = (cpu(farm.coordinator()), cpu(&page.process));
    tokio::time::sleep(WATCHED).await;
    cost(&format!("{TABS} tabs, a dictionary"), before.0);
    let web = (cpu(&page.process) - before.1) / WATCHED.as_secs_f64();
    println!("farmctl web, {TABS} tabs, a dictionary: {:.2} % of a core", 100.0 * web);
    let mut fresh = 0;
    for window in browsers.driver.windows().await.unwrap() {
        browsers.driver.switch_to_window(window).await.unwrap();
        fresh += u32::from(browsers.shown().await.contains("g2: running"));
    }
    println!("tabs that show the dictionary at work: {fresh} of {TABS}");
    browsers.end().await;
}

/// A browser with windows that show the farm, each in front, since hidden ones make no requests.
async fn watching(page: &Page) -> Browser {
    let browser = Browser::start().await;
    browser.open(&page.url()).await;
    for tab in 0..TABS {
        if tab > 0 {
            let window = browser.driver.new_window().await.unwrap();
            browser.driver.switch_to_window(window).await.unwrap();
        }
        browser.open(&format!("{}#/farm", page.home)).await;
        browser.element(By::Css("#workers")).await;
    }
    browser
}

/// Times in milliseconds; shown as median, 95 % quantile, maximum and count.
struct Spread(Vec<f64>);

impl Spread {
    fn of(mut times: Vec<f64>) -> Self {
        times.sort_by(f64::total_cmp);
        Self(times)
    }
}

impl std::fmt::Display for Spread {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self(times) = self;
        let Some(last) = times.last() else { return write!(f, "none") };
        let at = |share: f64| times[((times.len() - 1) as f64 * share).round() as usize];
        write!(f, "{:.1} ms (95 %: {:.1}, worst {last:.1}, n {})", at(0.5), at(0.95), times.len())
    }
}
