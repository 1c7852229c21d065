//! Open pages while workers and coordinators fail and return.

use farm_browser_tests::browser::{self, Browser};
use farm_tests::farm::Farm;
use farm_tests::page::Page;
use farm_tests::process::LONG;
use thirtyfour::By;

use super::{go_to, let_in};

/// Enough jobs to watch: for workers that take 0.3 s for each.
const LONG_GRID: &str = "sigma_t_per_mm = [2, 3, 4, 6, 8, 12, 16, 24]\nalbedo = [0.9, 0.99, 0.999]\n\
                         g = [0.0, 0.2, 0.4, 0.6]\nwalks = 5000\n";

const PACE: [&str; 2] = ["--pace-ms", "300"];

/// A killed worker and a restarted coordinator are shown, and the page continues without a reload.
#[tokio::test(flavor = "multi_thread")]
async fn page_survives_worker_and_coordinator_failures() {
    if !browser::is_there() {
        return;
    }
    let mut farm = Farm::start(&["--lease", "2"]);
    farm.submit("grid", LONG_GRID);
    let page = Page::start(farm.folder(), &["--server", &farm.url()]);
    let browser = let_in(&page).await;
    go_to(&browser, "Farm").await;
    browser.shows("grid: running").await;
    // More windows than the browser's limit of connections, all of them visible.
    for _ in 0..7 {
        let window = browser.driver.new_window().await.unwrap();
        browser.driver.switch_to_window(window).await.unwrap();
        browser.open(&format!("{}#/farm?name=grid", page.home)).await;
        browser.shows("grid: running").await;
    }
    // A last window, which is watched, on the same dictionary.
    let first = browser.driver.window().await.unwrap();
    let second = browser.driver.new_tab().await.unwrap();
    browser.driver.switch_to_window(second.clone()).await.unwrap();
    browser.open(&format!("{}#/farm?name=grid", page.home)).await;
    browser.shows("grid: running").await;
    mark(&browser).await;
    browser.driver.switch_to_window(first.clone()).await.unwrap();
    mark(&browser).await;

    let mut worker = farm.worker("ada", &PACE);
    browser.shows("ada").await;
    let before = wait_for_jobs(&browser, 1).await;
    worker.kill();
    browser
        .wait("ada is missed", LONG, async |browser| {
            state_of(browser, "ada").await.filter(|state| state == "silent")
        })
        .await;
    browser.shows("has not been heard of").await;
    let _other = farm.worker("bea", &PACE);
    wait_for_jobs(&browser, before + 1).await;

    farm.kill_coordinator();
    browser.shows("The farm cannot be reached").await;
    farm.start_coordinator();
    for tab in [second, first] {
        browser.driver.switch_to_window(tab).await.unwrap();
        browser.shows_within("grid: done, 100 % of the work", LONG).await;
        wait_for_jobs(&browser, 64).await;
        assert!(!browser.shown().await.contains("cannot be reached"));
        let kept = browser.script("return window.marked === true", vec![]).await;
        assert_eq!(kept, true, "the page was loaded again");
    }
    browser.end().await;
}

/// Sets a variable that a reload would lose.
async fn mark(browser: &Browser) {
    browser.script("window.marked = true", vec![]).await;
}

/// Jobs that the cells show as done; waits until there are at least `least`.
async fn wait_for_jobs(browser: &Browser, least: u64) -> u64 {
    browser
        .wait(&format!("{least} jobs are done"), LONG, async |browser| {
            let cells = browser.driver.find(By::Css("[aria-label^='States of']")).await.ok()?;
            let label = cells.attr("aria-label").await.ok()??;
            let numbers = label.split([':', ';']).skip(1).filter_map(|part| part.trim().split_once(' '));
            let done: u64 = numbers
                .filter(|(_, what)| ["done", "checked by the coordinator"].contains(what))
                .filter_map(|(number, _)| number.parse::<u64>().ok())
                .sum();
            (done >= least).then_some(done)
        })
        .await
}

async fn state_of(browser: &Browser, worker: &str) -> Option<String> {
    let cell = By::XPath(format!("//tr[td[normalize-space()=\"{worker}\"]]/td[2]"));
    browser.driver.find(cell).await.ok()?.text().await.ok()
}
