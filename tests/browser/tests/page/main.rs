//! The page of `farmctl web` in a real browser: the workflows of users, and faults during them.
//!
//! Screenshots go to the folder that `FARM_TEST_PICTURES` names; those in `docs/page` were made this way.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

mod accessible;
mod bad_input;
mod crowd;
mod entrance;
mod first_use;
mod kept;
mod looks;
mod new_dictionary;
mod recovery;

use std::path::Path;

use farm_browser_tests::browser::Browser;
use farm_tests::page::Page;
use farm_tests::process::{LONG, SOON, run};
use tempfile::TempDir;
use thirtyfour::By;

/// A coarse grid around the white example: 180 records in 36 jobs.
const GRID: &str = "sigma_t_per_mm = [5, 7, 10, 14, 20, 28]\nalbedo = [0.995, 0.998, 0.999, 0.9995, 0.9999]\n\
                    g = [0.2, 0.4, 0.6]\nwalks = 20000\n";

/// A folder with the grid `coarse.toml`, and with its dictionary.
fn folder_with_dictionary() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_grid(folder.path());
    let submitted = run(folder.path(), &["submit", "coarse.toml", "-q"]);
    assert_eq!(submitted.code, 0, "{}", submitted.stderr);
    folder
}

fn write_grid(folder: &Path) {
    std::fs::write(folder.join("coarse.toml"), GRID).unwrap();
}

/// A browser that has opened the page with its token.
async fn let_in(page: &Page) -> Browser {
    let browser = Browser::start().await;
    browser.open(&page.url()).await;
    browser
        .wait("the token is out of the address", SOON, async |browser| {
            let url = browser.driver.current_url().await.ok()?;
            url.as_str().starts_with(&page.home).then(|| url.query().is_none())?.then_some(())
        })
        .await;
    browser
}

/// Opens a tab of the page by its link.
async fn go_to(browser: &Browser, place: &str) {
    browser.element(By::LinkText(place)).await.click().await.unwrap();
    browser.element(By::XPath(format!("//nav/a[@aria-current=\"page\" and text()=\"{place}\"]"))).await;
}

/// Measures the page's example.
async fn measure_the_example(browser: &Browser) {
    go_to(browser, "Measure").await;
    // One may be open already.
    let close = By::XPath("//button[text()=\"Another measurement\"]".to_owned());
    if let Ok(close) = browser.driver.find(close).await {
        close.click().await.unwrap();
    }
    browser.press("Try the example").await;
    browser.shows("white (R, G, B at 0.5, 1 mm)").await;
    browser.press("Measure").await;
    browser.element(By::XPath("//h2[text()=\"Media\"]".to_owned())).await;
    browser
        .wait("maps and profiles", LONG, async |browser| {
            browser.driver.find(By::Css("section[aria-label=Explore] .u-over")).await.ok()?;
            browser.driver.find(By::Css("section[aria-label=Explore] canvas.cells")).await.ok()
        })
        .await;
}
