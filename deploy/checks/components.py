"""Prints the packages that are compiled into the programs, as CycloneDX 1.6 in JSON, from Cargo's metadata and lock file.

    python3 deploy/checks/components.py > resin-farm.cdx.json
"""

import json
import pathlib
import subprocess
import sys
import tomllib

CHECKOUT = pathlib.Path(__file__).resolve().parents[2]
PROGRAMS = {"farmctl", "farm-coordinator", "farm-worker"}


def metadata():
    command = ["cargo", "metadata", "--format-version=1", "--locked", f"--filter-platform={host()}"]
    return json.loads(subprocess.run(command, cwd=CHECKOUT, check=True, capture_output=True, text=True).stdout)


def host():
    output = subprocess.run(["rustc", "--version", "--verbose"], check=True, capture_output=True, text=True).stdout
    return next(line.removeprefix("host: ") for line in output.splitlines() if line.startswith("host: "))


def compiled_in(found):
    """Identities of the packages that the programs need at run time, without those for building and for tests."""
    nodes = {node["id"]: node for node in found["resolve"]["nodes"]}
    waiting = [package["id"] for package in found["packages"] if package["name"] in PROGRAMS]
    needed = set()
    while waiting:
        package = waiting.pop()
        if package in needed:
            continue
        needed.add(package)
        for dependency in nodes[package]["deps"]:
            if any(kind["kind"] is None for kind in dependency["dep_kinds"]):
                waiting.append(dependency["pkg"])
    return needed


def main():
    found = metadata()
    with open(CHECKOUT / "Cargo.lock", "rb") as file:
        locked = tomllib.load(file)["package"]
    checksums = {(package["name"], package["version"]): package.get("checksum") for package in locked}
    needed = compiled_in(found)
    components = []
    for package in sorted(found["packages"], key=lambda p: (p["name"], p["version"])):
        if package["id"] not in needed:
            continue
        name, version = package["name"], package["version"]
        component = {"type": "library", "name": name, "version": version, "purl": f"pkg:cargo/{name}@{version}"}
        if package["license"]:
            # "MIT/Apache-2.0" is a former notation of "or".
            component["licenses"] = [{"expression": package["license"].replace("/", " OR ")}]
        if checksum := checksums.get((name, version)):
            component["hashes"] = [{"alg": "SHA-256", "content": checksum}]
        components.append(component)
    own = next(package for package in found["packages"] if package["name"] == "farmctl")
    sbom = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": {"type": "application", "name": "resin-farm", "version": own["version"]}},
        "components": components,
    }
    json.dump(sbom, sys.stdout, indent=1)
    print()


if __name__ == "__main__":
    main()
