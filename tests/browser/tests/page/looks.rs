//! Layout: each tab at desktop and phone width, in light and dark, with nothing cut off.

use std::path::PathBuf;

use farm_browser_tests::browser::{self, Browser};
use farm_tests::page::Page;
use farm_tests::process::{LONG, SOON, run};
use farm_tests::reference::root;
use serde_json::json;

use super::{go_to, let_in, measure_the_example, write_grid};

const WIDE: u32 = 1280;
const NARROW: u32 = 390;

/// Nothing is cut off on a desktop or a phone, in the light or the dark scheme.
#[tokio::test(flavor = "multi_thread")]
async fn nothing_is_cut_off_at_any_size() {
    if !browser::is_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    write_grid(folder.path());
    let grid = if pictures().is_some() { "paper" } else { "coarse.toml" };
    let submitted = run(folder.path(), &["submit", grid, "-q"]);
    assert_eq!(submitted.code, 0, "{}", submitted.stderr);
    let session = root().join("examples/session/session.toml");
    let captured = run(folder.path(), &["capture", session.to_str().unwrap(), "-o", "session"]);
    assert_eq!(captured.code, 0, "{}", captured.stderr);
    let page = Page::start(folder.path(), &[]);
    let browser = let_in(&page).await;
    for (dark, width) in [(false, WIDE), (true, NARROW)] {
        browser.dark(dark).await;
        browser.size(width, 900).await;
        measure_the_example(&browser).await;
        browser.press("Predict").await;
        browser.shows("Radiance factors of white:1").await;
        look(&browser, "measure", dark, width).await;
        go_to(&browser, "Dictionary").await;
        browser.shows("± ").await;
        browser.press("Keep to compare").await;
        browser.press("white G").await;
        browser.shows("between records").await;
        look(&browser, "dictionary", dark, width).await;
        go_to(&browser, "Farm").await;
        browser.shows_within("0 waiting", LONG).await;
        if pictures().is_some() {
            half_a_dictionary(&browser, if dark { "darker" } else { "finer" }).await;
        }
        look(&browser, "farm", dark, width).await;
        go_to(&browser, "Capture").await;
        browser.css("iframe").await;
        look(&browser, "capture", dark, width).await;
    }
    assert_eq!(browser.complaints().await, Vec::<String>::new());
    browser.end().await;
}

/// Has the farm compute a dictionary until a good part is done.
async fn half_a_dictionary(browser: &Browser, name: &str) {
    let open = "const new_one = [...document.querySelectorAll('details')].find((d) => d.innerText.includes('Compute a new one')); \
                new_one.open = true";
    browser.script(open, vec![]).await;
    browser.pick("form select[name=scene]", "paper").await;
    let field = browser.css("form input[type=text]").await;
    field.clear().await.unwrap();
    field.send_keys(name).await.unwrap();
    browser.pick("form select[name=noise]", "fine").await;
    browser.shows("34,276 records in 836 jobs").await;
    browser.press("Compute").await;
    browser.shows(&format!("{name}: running")).await;
    browser.script("document.querySelectorAll('details').forEach((d) => (d.open = false))", vec![]).await;
    browser
        .wait("a good part is done", LONG, async |browser| {
            let shown = browser.shown().await;
            let done = shown.split_once(" done\n")?.0.rsplit_once('\n')?.1.parse::<u32>().ok()?;
            (done > 300).then_some(())
        })
        .await;
}

/// The folder for screenshots, if one is set.
fn pictures() -> Option<PathBuf> {
    std::env::var_os("FARM_TEST_PICTURES").map(Into::into)
}

/// Checks that nothing is wider than the page and that its background is light or dark as set; takes a screenshot.
async fn look(browser: &Browser, place: &str, dark: bool, width: u32) {
    let measured = browser.script(MEASURE, vec![]).await;
    assert_eq!(measured["beyond"], json!([]), "{place} at {width} pixels");
    assert_eq!(measured["width"], measured["room"], "{place}: it must be scrolled sideways");
    let light = measured["light"].as_f64().unwrap();
    assert!(if dark { light < 60.0 } else { light > 200.0 }, "{place}: a background of {light}");
    let height = measured["height"].as_u64().unwrap().clamp(900, 3600);
    let Some(folder) = pictures() else { return };
    std::fs::create_dir_all(&folder).unwrap();
    browser.size(width, height as u32).await;
    browser
        .wait("it is drawn again", SOON, async |browser| {
            (browser.script("return innerHeight", vec![]).await == height).then_some(())
        })
        .await;
    browser.script("window.scrollTo(0, 0)", vec![]).await;
    tokio::time::sleep(std::time::Duration::from_millis(400)).await;
    let name = format!("{place}-{}.png", if dark { "phone-dark" } else { "desk" });
    browser.driver.screenshot(&folder.join(name)).await.unwrap();
    browser.size(width, 900).await;
}

/// Elements beyond the page's right side that are not within a scrollable one.
const MEASURE: &str = "const within = (e) => { for (let p = e; p; p = p.parentElement) { \
       if (['auto', 'scroll', 'hidden'].includes(getComputedStyle(p).overflowX)) return true; } return false; }; \
     const beyond = [...document.querySelectorAll('main *, header *')].filter((e) => \
       e.getBoundingClientRect().right > document.documentElement.clientWidth + 1 && !within(e.parentElement)).map((e) => e.outerHTML.slice(0, 80)); \
     const [r, g, b] = getComputedStyle(document.documentElement).backgroundColor.match(/\\d+/g).map(Number); \
     return { width: document.documentElement.scrollWidth, room: document.documentElement.clientWidth, height: document.documentElement.scrollHeight, beyond, \
       light: (r + g + b) / 3 }";
