//! A farm with more workers and jobs than a page can show at once.

use farm_browser_tests::browser;
use farm_tests::farm::Farm;
use farm_tests::page::Page;
use farm_tests::process::SOON;
use farm_tests::test_worker::TestWorker;
use optics_model::grid::Axes;
use optics_model::scene::{Channel, Scene, Sensor};
use optics_model::{Grid, Walks};
use thirtyfour::By;

use super::let_in;

const WORKERS: usize = 1000;

/// 100,000 jobs of one small record each.
fn large() -> Grid {
    let steps = |from: f64, step: f64, count: usize| (0..count).map(|i| from + step * i as f64).collect();
    let axes = Axes {
        sigma_t_per_mm: steps(1.0, 1.0 / 64.0, 400),
        albedo: vec![0.9],
        g: steps(-0.5, 1.0 / 256.0, 250),
        thickness_mm: vec![1.0],
        sample_ior: vec![1.53],
    };
    let scene = Scene::paper().with_channels(vec![Channel::new("R", 0.985, 0.024).unwrap()]).unwrap();
    let scene = scene.with_sensor(Sensor::new(10.0, 8, 0.0).unwrap());
    Grid::new(scene, axes, Walks::new(5000).unwrap(), 1, false).unwrap()
}

/// Checked with 1,000 workers and 100,000 jobs.
#[tokio::test(flavor = "multi_thread")]
async fn large_farms_are_shown_page_by_page() {
    if !browser::is_there() {
        return;
    }
    let farm = Farm::start(&["--lease", "600"]);
    farm.submit_grid("large", &large()).await.unwrap();
    let link = farm.link();
    let mut crew = Vec::new();
    for i in 0..WORKERS {
        crew.push(TestWorker::register(link.clone(), &format!("test-{i:04}")).await.unwrap());
    }
    // Some of the jobs are running.
    for worker in &mut crew[..50] {
        assert!(!worker.acquire(4).await.unwrap().is_empty());
    }
    let mut page = Page::start(farm.folder(), &["--server", &farm.url()]);
    let browser = let_in(&page).await;
    browser.open(&format!("{}#/farm", page.home)).await;
    browser.shows("1,000 workers").await;
    browser.shows("99,800 waiting").await;
    browser.shows("200 computing").await;
    let rows = By::XPath("//section[h2[text()=\"Workers\"]]//tbody/tr".to_owned());
    let names = async |number: usize| {
        browser
            .wait("rows of workers", SOON, async |browser| {
                let shown = browser.shown().await;
                if !shown.contains(&format!("page {number}")) {
                    return None;
                }
                let rows = browser.driver.find_all(rows.clone()).await.ok()?;
                let mut names = Vec::new();
                for row in rows {
                    names.push(row.find(By::Css("td")).await.ok()?.text().await.ok()?);
                }
                Some(names)
            })
            .await
    };
    let first = names(1).await;
    assert_eq!(first.len(), 25, "a page of workers");
    browser.press("Next").await;
    let second = browser
        .wait("the second page", SOON, async |_| {
            let second = names(2).await;
            (second != first).then_some(second)
        })
        .await;
    assert!(second.iter().all(|name| !first.contains(name)), "{first:?} {second:?}");
    assert_eq!(browser.complaints().await, Vec::<String>::new());
    // Open streams do not keep the server from ending.
    assert_eq!(page.process.terminate(SOON), 0);
    browser.end().await;
}
