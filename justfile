# Shortcuts; everything works with cargo alone. `just --list` shows them.

# What CI runs: format, lints, all tests.
ci:
    bash .ci/run

# The quick tests of one crate, as in `just test farm-worker`.
test crate:
    cargo test -p {{crate}}

# The physics with 16 times the walks: 32 million a row of the exact values.
physics-long effort="16":
    FARM_TEST_EFFORT={{effort}} cargo test -p farm-tests --test physics uniform -- --nocapture

# kill -9 in 60 rounds each for embedded and separate processes.
recovery-long effort="10":
    FARM_TEST_EFFORT={{effort}} cargo test -p farm-tests --test recovery -- --nocapture

# The paper's dictionary, timed, in a folder of its own.
dictionary folder="/tmp/farm-dictionary":
    cargo build --release
    mkdir -p {{folder}}
    time ./target/release/farmctl submit --data {{folder}}
