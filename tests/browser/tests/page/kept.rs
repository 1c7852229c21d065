//! Measurements that are kept: recent ones, links, notes, comparison, and answers that follow the set-up.

use farm_browser_tests::browser::{self, Browser};
use farm_tests::page::Page;
use farm_tests::process::LONG;
use thirtyfour::By;

use super::{folder_with_dictionary, go_to, let_in, measure_the_example};

/// A measurement has a link that another browser opens, a title and a note; a changed set-up is another one, and both are
/// compared.
#[tokio::test(flavor = "multi_thread")]
async fn measurements_are_kept_linked_and_compared() {
    if !browser::is_there() {
        return;
    }
    let folder = folder_with_dictionary();
    let page = Page::start(folder.path(), &[]);
    let browser = let_in(&page).await;
    measure_the_example(&browser).await;
    let link = kept_link(&browser).await;
    write(&browser, "Title", "first print").await;
    write(&browser, "Note", "slab 2 scratched").await;

    // The fit follows the set-up, and is kept when it is asked for.
    browser
        .element(By::XPath("//summary[starts-with(text(), \"Set-up\")]".to_owned()))
        .await
        .click()
        .await
        .unwrap();
    write(&browser, "Standard error of each profile's own gain", "0.02").await;
    browser.shows_within("This answer is not kept.", LONG).await;
    // It is given now, not assumed.
    browser
        .wait("the gain is given", LONG, async |browser| {
            (!browser.shown().await.contains("gain ±")).then_some(())
        })
        .await;
    browser.shows("--gain-std-error 0.02").await;
    browser.press("Keep it").await;
    let second = kept_link(&browser).await;
    assert_ne!(link, second);

    // Another browser, without any state, opens the first by its link.
    let other = let_in(&page).await;
    other.open(&link).await;
    other.shows_within("Intervals of 95 %", LONG).await;
    other.shows("gain ± 0.3 %").await;
    let note = other.css("section[aria-label=Media] textarea").await;
    assert_eq!(note.value().await.unwrap().as_deref(), Some("slab 2 scratched"));
    other.driver.refresh().await.unwrap();
    other.shows_within("Intervals of 95 %", LONG).await;
    // A measurement that does not exist is an error, and the page continues.
    let gone = format!("{}#/measure?kept=0123456789abcdef", page.home);
    other.open("about:blank").await;
    other.open(&gone).await;
    other.shows("measurement 0123456789abcdef does not exist").await;
    other.end().await;

    browser.press("Another measurement").await;
    browser.shows("first print").await;
    browser.shows("slab 2 scratched").await;
    for which in ["first print", "white (gain-std-error 0.02)"] {
        browser.css(&format!("input[aria-label=\"Compare {which}\"]")).await.click().await.unwrap();
    }
    browser.press("Compare two").await;
    browser.shows_within("both are of the same profiles", LONG).await;
    assert_eq!(browser.complaints().await, Vec::<String>::new());
    browser.end().await;
}

/// The address once it has the id of the kept measurement.
async fn kept_link(browser: &Browser) -> String {
    browser
        .wait("the link of the measurement", LONG, async |browser| {
            let url = browser.driver.current_url().await.ok()?;
            url.fragment()?.contains("kept=").then(|| url.to_string())
        })
        .await
}

/// Replaces the text of the field with this label, and leaves it.
async fn write(browser: &Browser, label: &str, text: &str) {
    let field = format!("//label[contains(., \"{label}\")]//*[self::input or self::textarea]");
    let field = browser.element(By::XPath(field)).await;
    field.scroll_into_view().await.unwrap();
    field.click().await.unwrap();
    let select = thirtyfour::Key::Control + "a";
    field.send_keys(select).await.unwrap();
    field.send_keys(text).await.unwrap();
    field.send_keys("\t").await.unwrap();
}

/// A capture is started from the session file, its steps and its end are shown, and a wrong session names the reason.
#[tokio::test(flavor = "multi_thread")]
async fn captures_are_started_from_the_page() {
    if !browser::is_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let session = farm_tests::reference::root().join("examples/session");
    let photographs = folder.path().join("shots");
    std::fs::create_dir(&photographs).unwrap();
    for entry in std::fs::read_dir(session).unwrap() {
        let path = entry.unwrap().path();
        std::fs::copy(&path, photographs.join(path.file_name().unwrap())).unwrap();
    }
    let page = Page::start(folder.path(), &[]);
    let browser = let_in(&page).await;
    go_to(&browser, "Capture").await;
    browser.shows("farmctl capture shots/session.toml -o shots-capture").await;
    browser.press("Capture").await;
    browser.shows_within("written to shots-capture", LONG).await;
    browser.css("iframe[title=\"Report of the capture shots-capture\"]").await;
    assert!(folder.path().join("shots-capture/measurements.csv").is_file());
    std::fs::write(photographs.join("board_1.dng"), "no photograph").unwrap();
    browser.press("Capture").await;
    browser.shows_within("is not usable yet", LONG).await;
    browser.shows("board_1.dng").await;
    browser.end().await;
}
