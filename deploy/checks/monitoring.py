"""Tests the dashboard and the alerts with a real Prometheus that scrapes a working farm.

    monitoring.py MONITORING_FOLDER SCALED_OBJECT METRICS_ADDRESS PROMETHEUS_ADDRESS

Prometheus runs with the folder's configuration and scrapes the farm. Each query of the dashboard, and the one by which KEDA
scales the workers, must be answered, and contain only metrics that the farm has; queries that a computing farm answers
must have results; each alert must have been evaluated.
"""

import json
import pathlib
import re
import sys
import time
import urllib.parse
import urllib.request

import yaml

# Parts of queries without a result in this farm: nothing fails, no fit or check is made, and no backup is due.
MAY_BE_EMPTY = ("code!=", "farm_backup_age_seconds", "farm_fit_seconds", "farm_verifications_total", "farm_jobs_failed_total")


def fetch(url):
    with urllib.request.urlopen(url, timeout=10) as answer:
        return answer.read().decode()


def ask(prometheus, path, **parameters):
    answer = json.loads(fetch(f"http://{prometheus}/api/v1/{path}?{urllib.parse.urlencode(parameters)}"))
    if answer["status"] != "success":
        raise SystemExit(f"{path} {parameters}: {answer}")
    return answer["data"]


def queries(folder, scaled_object):
    for trigger in yaml.safe_load(scaled_object.read_text())["spec"]["triggers"]:
        yield "of KEDA", trigger["metadata"]["query"]
    dashboard = json.loads((folder / "dashboard.json").read_text())
    for panel in dashboard["panels"]:
        for target in panel["targets"]:
            # The farm has been scraped for seconds only, so rates are taken over seconds.
            expression = target["expr"].replace("$job", "resin-farm")
            yield panel["title"], re.sub(r"\[(5m|1h)\]", "[10s]", expression)


def known_metrics(metrics):
    """Names of the farm's metrics, without the suffixes for buckets and sums of histograms."""
    names = set(re.findall(r"^# TYPE (\S+) ", fetch(f"http://{metrics}/metrics"), flags=re.MULTILINE))
    # This metric does not exist before the first backup.
    return {re.sub("_total$", "", name) for name in names} | {"farm_backup_age_seconds"}


def main():
    folder, scaled_object = map(pathlib.Path, sys.argv[1:3])
    metrics, prometheus = sys.argv[3:]
    known = known_metrics(metrics)
    asked = list(queries(folder, scaled_object))
    for title, expression in asked:
        for name in re.findall(r"\b(?:farm|process)_\w+", expression):
            if re.sub(r"_(total|bucket|count|sum)$", "", name) not in known:
                raise SystemExit(f"panel {title}: {name} is no metric of the farm")
    deadline = time.monotonic() + 60
    while True:
        targets = ask(prometheus, "targets")["activeTargets"]
        rules = [rule for group in ask(prometheus, "rules")["groups"] for rule in group["rules"]]
        empty = [
            title
            for title, expression in asked
            if not ask(prometheus, "query", query=expression)["result"] and not any(w in expression for w in MAY_BE_EMPTY)
        ]
        up = [target["health"] for target in targets]
        evaluated = [rule["name"] for rule in rules if rule["health"] == "ok"]
        if up == ["up"] and not empty and len(evaluated) == len(rules) > 0:
            break
        if time.monotonic() > deadline:
            raise SystemExit(f"targets {up}; without figures {empty}; rules {[(r['name'], r['health']) for r in rules]}")
        time.sleep(1)
    print(f"target up, {len(evaluated)} alerts evaluated, {len(asked)} queries answered")


if __name__ == "__main__":
    main()
