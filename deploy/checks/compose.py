"""Checks rules of compose.yaml that are not in its schema.

usage: compose.py COMPOSE       checks it
       compose.py --run COMPOSE SERVICE   prints variables and command of a service, a word a line, for a trial
"""

import sys
from pathlib import Path

import yaml
from durations import enough_to_stop, seconds


def problems(document):
    for name, service in document["services"].items():
        for key, wanted in (("read_only", True), ("cap_drop", ["ALL"]), ("user", "65532:65532")):
            if service.get(key) != wanted:
                yield f"{name}: {key} must be {wanted}"
        if "no-new-privileges:true" not in service.get("security_opt", []):
            yield f"{name}: security_opt must have no-new-privileges:true"
        if service.get("privileged") or service.get("network_mode") or service.get("pid"):
            yield f"{name}: must not be privileged, nor share a namespace with the machine"
        for key in ("mem_limit", "pids_limit", "restart", "stop_grace_period"):
            if key not in service:
                yield f"{name}: {key} is missing"
        unknown = set(service.get("secrets", [])) - set(document["secrets"])
        yield from (f"{name}: there is no secret {secret}" for secret in sorted(unknown))
        yield from enough_to_stop(name, service["command"], seconds(service["stop_grace_period"]))
        yield from port_problems(name, service)
        yield from file_problems(name, service)


def port_problems(name, service):
    for port in service.get("ports", []):
        address = port.rpartition(":")[0].rpartition(":")[0]
        if not address.endswith(("127.0.0.1", "127.0.0.1}")):
            yield f"{name}: port {port} must be published on 127.0.0.1 by default"
        inner = port.rpartition(":")[2]
        if not any(word.endswith(f":{inner}") for word in service["command"]):
            yield f"{name}: nothing listens on the published port {inner}"


def file_problems(name, service):
    """Yields a problem for each file of a secret that the service does not have."""
    named = [*service["command"], *map(str, service.get("environment", {}).values())]
    for word in named:
        _, found, secret = word.partition("/run/secrets/")
        if found and secret not in service.get("secrets", []):
            yield f"{name}: {word}: the service has no secret {secret}"


def print_words(document, service):
    service = document["services"][service]
    for key, value in service.get("environment", {}).items():
        print(f"{key}={value}")
    print("\n".join(service["command"]))


def main():
    *mode, path = sys.argv[1:] if sys.argv[1] != "--run" else ("--run", sys.argv[3], sys.argv[2])
    document = yaml.safe_load(Path(path).read_text())
    if mode:
        print_words(document, mode[1])
        return
    wrong = list(problems(document))
    print("\n".join(wrong) or "  compose.yaml is hardened, consistent, and gives everybody time to stop")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
