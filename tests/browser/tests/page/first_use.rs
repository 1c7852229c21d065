//! The whole workflow from an empty folder to media, on the page alone.

use std::path::Path;

use farm_browser_tests::browser::{self, Browser};
use farm_tests::cli::set_axes;
use farm_tests::page::Page;
use farm_tests::process::{LONG, SOON, run};
use serde_json::{Value, json};
use thirtyfour::By;

use super::{go_to, let_in, measure_the_example, write_grid};

/// A grid is computed, the example is measured, and the media are saved.
#[tokio::test(flavor = "multi_thread")]
async fn first_use_computes_measures_and_saves() {
    if !browser::is_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    write_grid(folder.path());
    let mut page = Page::start(folder.path(), &[]);
    let browser = let_in(&page).await;
    // The default scene is that of a laboratory, unless the paper's scene is chosen.
    go_to(&browser, "Farm").await;
    browser.shows("There is none yet").await;
    browser.shows("50,344 records in 1,736 jobs").await;
    browser.shows("farmctl submit lab").await;
    browser.pick("form select[name=scene]", "paper").await;
    browser.shows("34,276 records in 836 jobs").await;
    // The example was rendered in that scene.
    go_to(&browser, "Measure").await;
    browser.press("Try the example").await;
    browser.shows("There is no finished dictionary").await;
    browser.element(By::LinkText("Compute one")).await.click().await.unwrap();
    browser.shows("34,276 records in 836 jobs").await;
    browser.choose_file("input[type=file]", &folder.path().join("coarse.toml")).await;
    browser.shows("180 records in 36 jobs").await;
    browser.press("Compute").await;
    fills(&browser).await;
    browser.shows_within("coarse: done, 100 % of the work", LONG).await;
    browser.shows("coarse is done: 180 records.").await;
    browser.shows("routine events").await;
    assert!(browser.driver.title().await.unwrap().starts_with("✓ "));

    measure_the_example(&browser).await;
    let line = browser.css("section[aria-label=Measurement] code").await.text().await.unwrap();
    assert_eq!(line, "farmctl measure white.csv --output media");
    browser.press("Save media and table").await;
    // An archive contains the names of its files uncompressed.
    let media = std::fs::read(browser.saved("media.zip").await).unwrap();
    for name in ["table.csv", "media.py", "media.xml", "media.pbrt", "media.json", "uncertainty.html"] {
        assert!(
            media.windows(name.len()).any(|bytes| bytes == name.as_bytes()),
            "{name} is not in media.zip"
        );
    }
    follows_the_crosshair(&browser).await;
    browser.press("Figures (PNG)").await;
    browser.saved("white.png").await;
    same_numbers_as_the_command(&browser, folder.path()).await;
    same_print_as_the_command(&browser, folder.path()).await;

    go_to(&browser, "Dictionary").await;
    browser.shows("± ").await;
    browser.shows("Edge seen through the slab").await;
    browser.press("Keep to compare").await;
    browser.press("Drop 1 kept").await;
    browser.press("Figure (SVG)").await;
    for (part, button, text) in [
        ("Simulate this slab", "Simulate", "standard errors of both"),
        ("Which slabs to photograph", "Predict", "at the Cramér–Rao bound"),
    ] {
        let summary = By::XPath(format!("//summary[text()=\"{part}\"]"));
        browser.element(summary).await.click().await.unwrap();
        browser.press(button).await;
        browser.shows(text).await;
    }
    assert_eq!(browser.complaints().await, Vec::<String>::new());
    // An open page does not keep the server from ending.
    go_to(&browser, "Farm").await;
    assert_eq!(page.process.terminate(SOON), 0);
    browser.shows("No connection to the server of this page").await;
    browser.end().await;
}

/// The label of the cells counts the jobs that are done, and the number rises.
async fn fills(browser: &Browser) {
    let done = browser
        .wait("cells", SOON, async |browser| {
            let cells = browser.driver.find(By::Css("[aria-label^='States of']")).await.ok()?;
            let label = cells.attr("aria-label").await.ok()??;
            let (_, done) = label.strip_prefix("States of 36 jobs: ")?.split_once("computing; ")?;
            done.split(' ').next()?.parse::<u32>().ok().filter(|done| *done > 0)
        })
        .await;
    assert!(done <= 36);
}

/// A press on the map, once it is there, moves the crosshair, and the address contains the position.
async fn follows_the_crosshair(browser: &Browser) {
    let pressed = browser.wait("crosshair", SOON, async |browser| {
        let map = browser.driver.find(By::Css("section[aria-label=Explore] .holder")).await.ok()?;
        map.scroll_into_view().await.ok()?;
        let press = browser.driver.action_chain().move_to_element_with_offset(&map, 30, 20).click();
        press.perform().await.ok()?;
        let url = browser.driver.current_url().await.ok()?;
        let place = url.fragment()?.to_owned();
        Some(place).filter(|place| place.contains("sigma_t=") && place.contains("albedo="))
    });
    let place = pressed.await;
    assert!(place.starts_with("/measure?"), "{place}");
}

/// The page's table contains the numbers that `farmctl measure` prints for the same file.
async fn same_numbers_as_the_command(browser: &Browser, folder: &Path) {
    let white = farm_tests::reference::root().join("examples/white.csv");
    let ran = run(folder, &["measure", white.to_str().unwrap(), "--json"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    same_numbers(browser, &serde_json::from_str(&ran.stdout).unwrap()).await;
}

/// A print has the radiance factors of `farmctl predict`, and a wrong slab its message.
async fn same_print_as_the_command(browser: &Browser, folder: &Path) {
    let white = farm_tests::reference::root().join("examples/white.csv");
    let ran = run(folder, &["measure", white.to_str().unwrap(), "--output", "media"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let ran = run(folder, &["predict", "media", "white:1", "--geometry", "45:0", "--json"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let answer: Value = serde_json::from_str(&ran.stdout).unwrap();
    browser.press("Predict").await;
    browser.shows("Radiance factors of white:1").await;
    let cells = "return [...document.querySelectorAll('section[aria-label=Prints] tbody td:not(.soft)')].map((c) => c.textContent)";
    let shown = browser.script(cells, vec![]).await;
    let channels = answer["data"]["channels"].as_array().unwrap();
    let values = channels.iter().flat_map(|c| c["bases"].as_array().unwrap()).map(|b| &b["radiance_factor"]);
    let values: Vec<f64> = values.map(|v| v.as_f64().unwrap()).collect();
    let shown: Vec<f64> =
        shown.as_array().unwrap().iter().map(|v| v.as_str().unwrap().parse().unwrap()).collect();
    assert!(
        shown.len() == 6 && shown.iter().zip(&values).all(|(s, v)| (s - v).abs() < 1e-3),
        "{shown:?} {values:?}"
    );
    let slabs = browser.css("section[aria-label=Prints] input").await;
    slabs.clear().await.unwrap();
    slabs.send_keys("cyan:1").await.unwrap();
    browser.press("Predict").await;
    browser.shows("material \"cyan\" is not in the file: it has white").await;
}

async fn same_numbers(browser: &Browser, answer: &Value) {
    let shown = browser.css("[aria-label='Media, a table'] table").await.text().await.unwrap();
    let separates = |c: char| c.is_whitespace() || "()".contains(c);
    let numbers: Vec<f64> = shown.split(separates).filter_map(|number| number.parse().ok()).collect();
    let channels = answer["data"]["materials"][0]["channels"].as_array().unwrap();
    assert_eq!(channels.len(), 3);
    for channel in channels {
        let sigma_t = channel["refined"]["sigma_t_per_mm"].as_f64().unwrap();
        // The page rounds.
        let there = numbers.iter().any(|number| (number / sigma_t - 1.0).abs() < 0.006);
        assert!(there, "{sigma_t} is not in the page's table:\n{shown}");
    }
}

/// The page's tables of estimates and budget have the cells of those in the session's report.
async fn same_tables_as_the_report(browser: &Browser, report: &Path) {
    let report = std::fs::read_to_string(report).unwrap();
    for title in ["Estimates of the set-up", "Error budget of σ_t"] {
        let (_, table) = report.split_once(&format!("<h3>{title}")).unwrap();
        let (table, _) = table.split_once("</table>").unwrap();
        let cells = table.split("<td").skip(1).map(|cell| cell.split(['>', '<']).nth(1).unwrap());
        let cells: Vec<&str> = cells.collect();
        let script = format!(
            "return [...document.querySelectorAll('[aria-label=\"{title}, a table\"] tbody :is(th, td)')].map((c) => c.textContent)"
        );
        assert!(!cells.is_empty());
        assert_eq!(browser.script(&script, vec![]).await, json!(cells), "{title}");
    }
}

/// The example chooses its scene, own files choose `lab`, and a choice by hand stays.
#[tokio::test(flavor = "multi_thread")]
async fn example_chooses_the_papers_scene() {
    const WHY: &str = "The example was rendered in the paper's scene, whose surfaces lose light.";
    if !browser::is_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    for scene in ["lab", "paper"] {
        let grid = format!(
            "scene = \"{scene}\"\nsigma_t_per_mm = [5, 28]\nalbedo = [0.999]\ng = [0.4]\nthickness_mm = [1]\nwalks = 1000\n"
        );
        std::fs::write(folder.path().join(format!("{scene}.toml")), grid).unwrap();
    }
    let own = ["own.csv", "another.csv"].map(|name| folder.path().join(name));
    for own in &own {
        std::fs::copy(farm_tests::reference::root().join("examples/white.csv"), own).unwrap();
    }
    let submit = |grid: &str| {
        let submitted = run(folder.path(), &["submit", "-q", grid]);
        assert_eq!(submitted.code, 0, "{}", submitted.stderr);
    };
    submit("lab.toml");
    let page = Page::start(folder.path(), &[]);
    let browser = let_in(&page).await;
    browser.press("Try the example").await;
    browser.shows(&format!("{WHY} Compute a dictionary of it.")).await;
    submit("paper.toml");
    chosen(&browser, "paper").await;
    let shown = browser.shown().await;
    assert!(shown.contains(WHY) && !shown.contains("Compute a dictionary"), "{shown}");
    browser.choose_file("input[type=file]", &own[0]).await;
    browser.shows("own.csv").await;
    chosen(&browser, "lab").await;
    assert!(!browser.shown().await.contains(WHY));
    browser.pick("section[aria-label=Measurement] .options select", "paper").await;
    browser.choose_file("input[type=file]", &own[1]).await;
    browser.shows("another.csv").await;
    chosen(&browser, "paper").await;
    assert_eq!(browser.complaints().await, Vec::<String>::new());
    browser.end().await;
}

/// Waits until the dictionary is selected, and the command names it unless it is the usual one.
async fn chosen(browser: &Browser, name: &str) {
    browser
        .wait("the dictionary is selected", LONG, async |browser| {
            let select = "section[aria-label=Measurement] .options select";
            let value = format!("return document.querySelector('{select}')?.value ?? null");
            (browser.script(&value, vec![]).await == name).then_some(())
        })
        .await;
    let line = browser.css("section[aria-label=Measurement] code").await.text().await.unwrap();
    assert_eq!(line.contains("--dictionary paper"), name == "paper", "{line}");
}

/// A capture is measured with the dictionary of the command, and has the command's answer.
#[tokio::test(flavor = "multi_thread")]
async fn capture_is_measured_as_by_the_command() {
    if !browser::is_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let session = farm_tests::reference::root().join("examples/session/session.toml");
    let captured = run(folder.path(), &["capture", session.to_str().unwrap(), "-o", "session"]);
    assert_eq!(captured.code, 0, "{}", captured.stderr);
    // Coarser axes save time.
    let axes = "sigma_t_per_mm = [5, 6, 8, 10, 14, 20, 26]\nalbedo = [0.998, 0.999, 0.9995, 0.9999]\n\
                g = [0.2, 0.4, 0.6]\nwalks = 5000\n";
    set_axes(&folder.path().join("session/grid.toml"), axes);
    let page = Page::start(folder.path(), &[]);
    let browser = let_in(&page).await;
    go_to(&browser, "Capture").await;
    browser.element(By::LinkText("measure it")).await.click().await.unwrap();
    browser.shows("white (R, G, B at 0.512, 1.006 mm)").await;
    browser.shows("is to be computed: 168 records, which sessions with other boards share").await;
    browser.press("Compute it").await;
    browser
        .wait("it can be measured", LONG, async |browser| {
            let by =
                By::XPath("//section[@aria-label=\"Measurement\"]//button[text()=\"Measure\"]".to_owned());
            browser.driver.find(by).await.ok()?.is_enabled().await.ok()?.then_some(())
        })
        .await;
    browser.shows("by the session's white reference").await;
    browser.press("Measure").await;
    browser.shows("Intervals of 95 %").await;
    let line = browser.css("section[aria-label=Measurement] code").await.text().await.unwrap();
    assert_eq!(line, "farmctl measure session");
    let measured = run(folder.path(), &["measure", "session", "--json"]);
    assert_eq!(measured.code, 0, "{}", measured.stderr);
    // No other dictionary was computed.
    assert!(!measured.stderr.contains("records"), "{}", measured.stderr);
    same_numbers(&browser, &serde_json::from_str(&measured.stdout).unwrap()).await;
    same_tables_as_the_report(&browser, &folder.path().join("session/report.html")).await;
    // A link restores the view, also after a reload and from another tab.
    browser.css("section[aria-label=Explore] select").await;
    browser.pick("section[aria-label=Explore] select", "white B").await;
    follows_the_crosshair(&browser).await;
    let link = browser.driver.current_url().await.unwrap();
    let state = link.fragment().unwrap();
    assert!(state.contains("capture=session") && state.contains("look=white+B"), "{link}");
    for open in ["about:blank", "reload", "about:blank"] {
        if open == "reload" {
            browser.driver.refresh().await.unwrap();
        } else {
            browser.open(open).await;
            browser.open(link.as_str()).await;
        }
        browser.shows("Intervals of 95 %").await;
        browser.css("section[aria-label=Explore] canvas.cells").await;
        assert_eq!(browser.driver.current_url().await.unwrap(), link);
    }
    go_to(&browser, "Farm").await;
    go_to(&browser, "Measure").await;
    browser.shows("Intervals of 95 %").await;
    let back = browser.driver.current_url().await.unwrap();
    assert!(back.fragment().unwrap().contains("capture=session"), "{back}");
    assert_eq!(browser.complaints().await, Vec::<String>::new());
    browser.end().await;
}
