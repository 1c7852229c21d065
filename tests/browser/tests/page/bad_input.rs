//! Invalid files: the page shows an error for each and continues to work.

use farm_browser_tests::browser;
use farm_tests::cli::{HEAD, rows};
use farm_tests::page::Page;
use farm_tests::process::SOON;
use thirtyfour::By;

use super::{folder_with_dictionary, go_to, let_in};

/// Every kind of bad measurement is refused with the reason.
#[tokio::test(flavor = "multi_thread")]
async fn every_bad_measurement_is_explained() {
    if !browser::is_there() {
        return;
    }
    let folder = folder_with_dictionary();
    let good = [HEAD, &rows("R", 0.5), &rows("R", 1.0)].concat();
    let percent = |line: &str| match line.rsplit_once(',') {
        Some((names, value)) if value != "value" => {
            format!("{names},{}\n", 100.0 * value.parse::<f64>().unwrap())
        }
        _ => format!("{line}\n"),
    };
    let files: Vec<(&str, Vec<u8>, &str)> = vec![
        ("empty.csv", vec![], "is empty"),
        ("picture.csv", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".to_vec(), "this is a photograph"),
        ("book.csv", b"PK\x03\x04\x14\0\x06\0".to_vec(), "spreadsheet"),
        ("nothing.csv", HEAD.into(), "no rows"),
        ("columns.csv", good.replace("x_mm", "place").into(), "x_mm"),
        ("words.csv", good.replacen(",0.1", ",bright", 1).into(), "bright"),
        ("infinite.csv", good.replacen(",0.1", ",inf", 1).into(), "inf"),
        ("percent.csv", good.lines().map(percent).collect::<String>().into(), "linear radiance factors"),
        ("thick.csv", good.replace(",0.5,", ",-0.5,").into(), "-0.5"),
        ("short.csv", good.lines().take(4).collect::<Vec<_>>().join("\n").into(), "pixels is not valid"),
        ("torn.csv", good.as_bytes()[..good.len() - 9].to_vec(), "entries where the header has"),
    ];
    let page = Page::start(folder.path(), &[]);
    let browser = let_in(&page).await;
    for (name, content, message) in files {
        let file = folder.path().join(name);
        std::fs::write(&file, content).unwrap();
        browser.open("about:blank").await;
        browser.open(&page.home).await;
        browser.choose_file("section[aria-label=Measurement] input[type=file]", &file).await;
        let alert = browser.css("[role=alert]").await.text().await.unwrap();
        println!("{name}: {alert}");
        assert!(alert.contains(message) && alert.len() < 400, "{name}: {alert}");
        assert!(!browser.shown().await.contains("Best by"), "{name}: it can be measured");
    }
    // Afterwards a valid file is accepted.
    let file = folder.path().join("good.csv");
    std::fs::write(&file, good).unwrap();
    browser.choose_file("section[aria-label=Measurement] input[type=file]", &file).await;
    browser.shows("resin (R at 0.5, 1 mm)").await;
    browser.press("Measure").await;
    browser.shows("Intervals of 95 %").await;

    go_to(&browser, "Farm").await;
    browser
        .element(By::XPath("//summary[text()=\"Compute a new one\"]".to_owned()))
        .await
        .click()
        .await
        .unwrap();
    for (name, content, message) in [
        ("unknown.toml", "colour = 3\n", "colour"),
        ("albedo.toml", "albedo = [0.5, 1.5]\n", "1.5"),
        ("text.toml", "not a grid", "text.toml"),
    ] {
        let file = folder.path().join(name);
        std::fs::write(&file, content).unwrap();
        browser.choose_file("form input[type=file]", &file).await;
        let alert = browser.wait("the file is refused", SOON, async |browser| {
            let alert = browser.driver.find(By::Css("form [role=alert]")).await.ok()?.text().await.ok()?;
            alert.contains(message).then_some(alert)
        });
        println!("{name}: {}", alert.await);
        let compute = browser.driver.find(By::Css("form button.main")).await.unwrap();
        assert!(!compute.is_enabled().await.unwrap(), "{name}");
    }
    browser.end().await;
}
