//! The form for a new dictionary, filled in by hand.

use std::time::Duration;

use farm_browser_tests::browser;
use farm_tests::page::Page;
use thirtyfour::By;

use super::{folder_with_dictionary, go_to, let_in};

/// Between two letters of a slow typist.
const PAUSE: Duration = Duration::from_millis(400);

/// The list of dictionaries, which the page asks for again and again, does not close the form.
#[tokio::test(flavor = "multi_thread")]
async fn the_form_stays_open_while_typing() {
    if !browser::is_there() {
        return;
    }
    let folder = folder_with_dictionary();
    let page = Page::start(folder.path(), &[]);
    let browser = let_in(&page).await;
    go_to(&browser, "Farm").await;
    let summary = By::XPath("//summary[text()=\"Compute a new one\"]".to_owned());
    browser.element(summary).await.click().await.unwrap();
    let field = browser.css("form input[type=text]").await;
    field.clear().await.unwrap();
    for letter in "slowly typed".chars() {
        field.send_keys(letter.to_string()).await.unwrap();
        tokio::time::sleep(PAUSE).await;
    }
    assert!(field.is_displayed().await.unwrap(), "the form is closed");
    assert_eq!(field.value().await.unwrap().as_deref(), Some("slowly typed"));
    browser.end().await;
}
