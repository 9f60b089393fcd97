#!/usr/bin/env bash
# What generality costs on a matt scene, in instructions: the renderer over a loop that knows nothing else (benches/generality.rs). Fails above the
# aim of 1.03 (or the number in GENERALITY_MAX), or if the two pictures differ. Needs valgrind; arguments go to `cargo bench`.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

command -v valgrind >/dev/null || {
    echo "needs valgrind, to count instructions (apt-get install valgrind)" >&2
    exit 2
}
limit=${GENERALITY_MAX:-1.03}
[[ $limit =~ ^[0-9]+(\.[0-9]+)?$ ]] || {
    echo "GENERALITY_MAX is no number: $limit" >&2
    exit 2
}
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
cargo bench --bench generality --no-run "$@" 2>"$scratch/build.log" || { cat "$scratch/build.log" >&2; exit 2; }
program=$(sed -n 's/^ *Executable .*(\(.*\))$/\1/p' "$scratch/build.log")
[[ -x $program ]] || {
    echo "cargo named no program:" >&2
    cat "$scratch/build.log" >&2
    exit 2
}
arguments=(--wheels 1 --size 320 --compiled "$scratch/bricks.outcrop")
# Compares the pictures, and compiles the model, which does not run in valgrind.
"$program" "${arguments[@]}"
# The C library sets and copies larger pieces of memory by one instruction, which valgrind counts once for each byte: not here.
export GLIBC_TUNABLES=glibc.cpu.x86_rep_stosb_threshold=1000000000:glibc.cpu.x86_rep_movsb_threshold=1000000000
count() { # full | small
    valgrind --tool=callgrind --callgrind-out-file=/dev/null --toggle-collect='*measured*' "$program" "${arguments[@]}" "$1" \
        2>"$scratch/$1.log" >/dev/null || { cat "$scratch/$1.log" >&2; exit 1; }
    sed -n 's/.*Collected : //p' "$scratch/$1.log"
}
full=$(count full)
small=$(count small)
awk -v full="$full" -v small="$small" -v limit="$limit" 'BEGIN {
    full += 0; small += 0; limit += 0
    if (small < 1e6 || full < 1e6) { print "nothing was counted"; exit 1 }
    printf "renderer %.1f, small loop %.1f million instructions: %.4f (at most %s)\n", full / 1e6, small / 1e6, full / small, limit
    exit full / small > limit
}'
