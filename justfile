# Shortcuts; everything works with cargo alone. `just --list` shows them.

# The checks of CI: format, lints, documents, dependencies, all tests.
ci:
    bash .ci/run

# The quick tests of one crate, as in `just test optics-fit`.
test crate:
    cargo test -p {{crate}}

# The physics with 50 times the walks: 100 million per row of the exact values.
physics-long effort="50":
    FARM_TEST_EFFORT={{effort}} cargo test --workspace --test science uniform -- --nocapture

# Faults of a farm of real processes, in the long form: 200 rounds of kill -9, an absence of a minute, real keepalives.
faults-long effort="20":
    FARM_TEST_EFFORT={{effort}} cargo test --workspace --test whole faults -- --nocapture

# The scheduler against its model, with as many random histories as you like.
model-long cases="20000":
    PROPTEST_CASES={{cases}} cargo test -p farm-coordinator --lib model_tests

# A farm under load with random faults for an hour: records stay correct; memory, files and database do not grow.
soak minutes="60" seed="1":
    FARM_SOAK_MINUTES={{minutes}} FARM_SOAK_SEED={{seed}} cargo test --workspace --test whole soak -- --nocapture

# The paper's dictionary, timed, in a separate folder.
dictionary folder="/tmp/farm-dictionary":
    cargo build --release -p farmctl
    mkdir -p {{folder}}
    time ./target/release/farmctl submit --data {{folder}}

# Speed of the tracer's parts, of transport points and of the grid's average, for every kernel.
bench filter="":
    cargo bench -p optics-tracer -- "{{filter}}"

# A whole dictionary, ten times over; with 250000 walks it is the paper's.
bench-dictionary walks="25000":
    FARM_BENCH_WALKS={{walks}} cargo bench -p farm-tests --bench dictionary

# Load on a coordinator without tracing: "small", 1,000 workers and 100,000 small jobs; "paper", the paper's results at
# the pace of 64 cores; "two-cores", at that of two.
bench-load load="small":
    cargo bench -p farm-tests --bench load -- {{load}}

# Speed of the fit with the dictionary "paper" of a data folder (see `dictionary`).
bench-fit folder="/tmp/farm-dictionary" filter="":
    FARM_BENCH_DATA={{folder}} cargo bench -p farm-coordinator -- "{{filter}}"

# 200 independently traced media, fitted with the paper's whole dictionary: errors and coverage; some twelve minutes.
round-trip-long effort="8":
    FARM_TEST_EFFORT={{effort}} cargo test --workspace --test science there_and_back -- --nocapture --test-threads 1

# Mitsuba 3 on the same scene, side by side; `python` must have the packages mitsuba and numpy.
compare-mitsuba python="python3":
    cargo build --release -p farmctl
    {{python}} tests/mitsuba/compare.py

# The media that `measure` writes for the example, loaded by Mitsuba 3, with the dictionary of a data folder; `python`
# must have the package mitsuba.
media-mitsuba data="farm-data" python="python3":
    cargo build --release -p farmctl
    rm -rf target/media && mkdir -p target/media
    ./target/release/farmctl --data {{data}} measure examples/white.csv --mu 1 --g 0.4 -o target/media --json > target/media/measured.json
    {{python}} tests/mitsuba/media.py --expected target/media/measured.json --dict target/media/media.py --xml target/media/media.xml --pbrt target/media/media.pbrt

# The documents as a book in target/book/html, with dead links reported; needs mdBook.
book:
    cargo test -p farm-house documents
    docs/build

# Spelling, and licences, origins and duplicates of dependencies; needs typos and cargo-deny (see .ci/tools.txt).
audit:
    typos
    cargo deny check

# The present output of programs in all documents, those of Python too; needs a Python package index. Some ten minutes.
documents:
    cargo build --workspace --bins
    FARM_TEST_ACCEPT=1 FARM_TEST_EFFORT=10 cargo test --workspace --test whole documents
    FARM_TEST_ACCEPT=1 FARM_PROGRAMS=target/debug python/check -k documents

# The Python package: wheel, types and tests in a fresh virtual environment; needs a Python package index.
python:
    cargo build --release --workspace --bins
    FARM_PROGRAMS=target/release python/check

# The Python recipe of docs/python.md, exactly as it is written there; needs a Python package index.
recipe:
    cargo build --workspace --bins
    BIN=target/debug examples/check

# The deployment files against the programs, schemas and engines; some parts need root.
deploy-check:
    cargo build --workspace --bins
    BIN=target/debug deploy/check all

# Coordinator and worker on two network namespaces, over TLS, with a link that goes down; needs root and iproute2.
two-hosts:
    cargo build --release --workspace --bins
    deploy/two-hosts

# A private one-node Slurm cluster whose workers finish two dictionaries; needs root, munge, slurmctld, slurmd. Five minutes.
slurm-check:
    cargo build --release --workspace --bins
    deploy/slurm/check
