//! Writes metrics in the two text formats that scrapers request.
//!
//! OpenMetrics describes a counter without the `_total` of its samples, the older format with it; a reader of the older
//! one would take these counters for metrics without type or help.

use std::collections::HashSet;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Format {
    /// The format for scrapers that request it, as Prometheus does.
    OpenMetrics,
    /// The format for all others: curl, `promtool check metrics`, older collectors.
    Prometheus,
}

impl Format {
    /// Ignores quality factors: a client that names OpenMetrics can read it.
    pub(super) fn best_of<'a>(accepted: impl IntoIterator<Item = &'a str>) -> Self {
        let types = accepted.into_iter().flat_map(|line| line.split(','));
        let mut names = types.filter_map(|kind| kind.split(';').next());
        let open = names.any(|name| name.trim().eq_ignore_ascii_case("application/openmetrics-text"));
        if open { Self::OpenMetrics } else { Self::Prometheus }
    }

    pub(super) fn content_type(self) -> &'static str {
        match self {
            Self::OpenMetrics => "application/openmetrics-text; version=1.0.0; charset=utf-8",
            Self::Prometheus => "text/plain; version=0.0.4; charset=utf-8",
        }
    }
}

/// Rewrites OpenMetrics without units, exemplars and timestamps as the older format.
pub(super) fn to_prometheus(text: &str) -> String {
    let counter = |line: &'_ str| Some(line.strip_prefix("# TYPE ")?.strip_suffix(" counter")?.to_owned());
    let counters: HashSet<String> = text.lines().filter_map(counter).collect();
    let mut rewritten = String::with_capacity(text.len());
    for line in text.lines().filter(|line| *line != "# EOF") {
        rewritten.push_str(&described(line, &counters).unwrap_or_else(|| line.to_owned()));
        rewritten.push('\n');
    }
    rewritten
}

fn described(line: &str, counters: &HashSet<String>) -> Option<String> {
    let mark = ["# HELP ", "# TYPE "].into_iter().find(|mark| line.starts_with(mark))?;
    let (name, rest) = line[mark.len()..].split_once(' ')?;
    counters.contains(name).then(|| format!("{mark}{name}_total {rest}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// OpenMetrics is chosen only if the request accepts it; otherwise it is the Prometheus text format.
    #[test]
    fn open_metrics_format_must_be_requested() {
        let prometheus =
            "application/openmetrics-text;version=1.0.0;q=0.5,text/plain;version=0.0.4;q=0.4,*/*;q=0.1";
        assert_eq!(Format::best_of([prometheus]), Format::OpenMetrics);
        assert_eq!(Format::best_of(["text/plain", "Application/OpenMetrics-Text"]), Format::OpenMetrics);
        assert_eq!(Format::best_of(["*/*"]), Format::Prometheus);
        assert_eq!(Format::best_of([]), Format::Prometheus);
    }
}
