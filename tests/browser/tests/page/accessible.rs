//! Accessibility: the page with the keyboard alone, and for screen readers.

use farm_browser_tests::browser::{self, Browser};
use farm_tests::page::Page;
use farm_tests::process::{LONG, SOON};
use farm_tests::reference::root;
use serde_json::Value;
use thirtyfour::prelude::*;

use super::{folder_with_dictionary, go_to, let_in, measure_the_example};

/// Number of presses of the tab key that reach every element.
const MOST_TABS: usize = 120;

/// The accessibility checker finds no violation in any view, light or dark.
#[tokio::test(flavor = "multi_thread")]
async fn axe_finds_no_violation_in_any_view() {
    if !browser::is_there() {
        return;
    }
    let axe = root().join("web/node_modules/axe-core/axe.min.js");
    let Ok(axe) = std::fs::read_to_string(&axe) else {
        eprintln!("SKIPPED: {} is not there; `npm --prefix web ci` installs it", axe.display());
        return;
    };
    let folder = folder_with_dictionary();
    let page = Page::start(folder.path(), &[]);
    let browser = let_in(&page).await;
    measure_the_example(&browser).await;
    for place in ["Measure", "Dictionary", "Farm", "Capture"] {
        go_to(&browser, place).await;
        browser
            .wait("the place is drawn", SOON, async |browser| {
                browser.shown().await.lines().count().gt(&8).then_some(())
            })
            .await;
        for dark in [false, true] {
            browser.dark(dark).await;
            assert_eq!(violations(&browser, &axe).await, "", "{place}, dark: {dark}");
        }
    }
    browser.end().await;
}

/// Violations that axe finds: rule and elements.
async fn violations(browser: &Browser, axe: &str) -> String {
    let script = format!(
        "{axe}; const done = arguments[0]; axe.run(document, {{ iframes: false }}).then((found) => \
         done(found.violations.map((v) => `${{v.impact}} ${{v.id}}: ${{v.nodes.map((n) => n.target).join(' ')}}`).join('\\n')))"
    );
    let found = browser.driver.execute_async(&script, vec![]).await.unwrap();
    found.json().as_str().unwrap_or("axe returned nothing").to_owned()
}

/// A measurement can be made with the keyboard alone.
#[tokio::test(flavor = "multi_thread")]
async fn measuring_works_by_keyboard_alone() {
    if !browser::is_there() {
        return;
    }
    let folder = folder_with_dictionary();
    let page = Page::start(folder.path(), &[]);
    let browser = let_in(&page).await;
    browser.shows("Choose a measurement").await;
    tab_to(&browser, "Skip to the content").await;
    press(&browser, Key::Enter).await;
    tab_to(&browser, "Try the example").await;
    press(&browser, Key::Enter).await;
    browser.shows("white (R, G, B at 0.5, 1 mm)").await;
    tab_to(&browser, "Measure").await;
    press(&browser, Key::Enter).await;
    browser.shows_within("Intervals of 95 %", LONG).await;
    tab_to(&browser, "Save media and table").await;
    press(&browser, Key::Enter).await;
    browser.saved("media.zip").await;
    browser.css("section[aria-label=Explore] canvas.cells").await;
    // The crosshair of the map moves by the arrow keys and by its sliders.
    tab_to(&browser, "Crosshair on the map").await;
    press(&browser, Key::Up).await;
    let url = browser.driver.current_url().await.unwrap();
    assert!(url.fragment().is_some_and(|state| state.contains("sigma_t=")), "{url}");
    browser.shows("At the crosshair: σ_t").await;
    for (slider, parameter) in [("σ_t [1/mm]", "sigma_t="), ("α", "albedo="), ("scale factor μ", "scale=")]
    {
        tab_to(&browser, slider).await;
        press(&browser, Key::Right).await;
        let url = browser.driver.current_url().await.unwrap();
        assert!(url.fragment().is_some_and(|state| state.contains(parameter)), "{slider}: {url}");
    }
    tab_to(&browser, "Back to the best").await;
    press(&browser, Key::Enter).await;
    let url = browser.driver.current_url().await.unwrap();
    assert!(url.fragment().is_some_and(|state| !state.contains("albedo=")), "{url}");
    browser.end().await;
}

/// Presses the tab key until the element of this name has the focus, and checks that the focus is visible.
async fn tab_to(browser: &Browser, name: &str) {
    let mut passed = Vec::new();
    for _ in 0..MOST_TABS {
        press(browser, Key::Tab).await;
        let focused = browser.script(FOCUSED, vec![]).await;
        if focused["name"].as_str().unwrap().starts_with(name) {
            assert_eq!(focused["seen"], Value::Bool(true), "{name}: the focus is not visible");
            return;
        }
        passed.push(focused["name"].as_str().unwrap().lines().next().unwrap_or_default().to_owned());
    }
    panic!("the tab key does not lead to {name:?}, but to {passed:?}");
}

const FOCUSED: &str = "const e = document.activeElement; const style = getComputedStyle(e); \
     const box = e.getBoundingClientRect(); \
     const name = (e.labels?.[0]?.innerText ?? e.getAttribute('aria-label') ?? e.innerText ?? '').trim(); \
     const seen = style.outlineStyle !== 'none' && box.bottom > 0 && box.top < innerHeight && box.right > 0; \
     return { name, seen }";

async fn press(browser: &Browser, key: Key) {
    browser.driver.action_chain().send_keys(key).perform().await.unwrap();
}
