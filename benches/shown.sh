#!/usr/bin/env bash
# What the project claims of whole runs, shown: prints Markdown tables of exit codes, processor time, memory and image
# comparisons for gears n = 8 (14,057,568 triangles). Makes its models with the `gears` example.
#
#     benches/shown.sh FOLDER [caps|compile|image|touched|failures]...
#
# FOLDER is for models and results (about 3 GiB). Parts that need root (memory caps, a small file system) say so and are
# left out without it. Processor time is user and system together, as the kernel counted it for the process.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
(($# >= 1)) || { sed -n '2,9s/^# \{0,1\}//p' "${BASH_SOURCE[0]}"; exit 2; }
mkdir -p "$1"
cd "$1"
shift
parts=("$@")
(($#)) || parts=(caps compile image touched failures)
(cd "$root" && cargo build --release --examples --quiet)
bin=$root/target/release/examples
view=(--eye -1.1,-2.1,2.6 --look-at 0,0,0 --up 0,0,1 --light 2,4,4 --light -2,4,3 --light 2,-2.5,2.5 --light -1,-4,2
    --light -1.111,-2.121,2.626)

# The plain models are without materials; the one with `-m` has mirrors and glass.
[[ -f gears8.ply ]] || "$bin/gears" --n 8 -o gears8.ply
[[ -f gears8.obj ]] || "$bin/gears" --n 8 -o gears8.obj
[[ -f gears8-m.ply ]] || "$bin/gears" --n 8 --materials -o gears8-m.ply

# Runs a command, keeps what it prints in log.txt; sets `cpu` (seconds), `wall` and `code`.
timed() { # COMMAND...
    code=0
    local TIMEFORMAT='%U %S %R'
    { time "$@" >log.txt 2>&1 || code=$?; } 2>time.txt
    read -r user system wall < <(tail -1 time.txt)
    cpu=$(awk "BEGIN { printf \"%.2f\", $user + $system }")
}
# The resident peak as the run itself reports it from VmHWM.
resident() { grep -o '[0-9.]* [KMG]iB resident' log.txt | tail -1 | sed 's/ resident//' || true; }
rate() { awk "BEGIN { printf \"%.1f\", 14.057568 / $1 }"; }
median() { sort -n | awk '{ x[NR] = $1 } END { print x[int((NR + 1) / 2)] }'; }

caps() {
    echo '### Under a hard memory cap, page cache included, from cold files'
    echo
    echo '| cap | job | budget | exit code | CPU s | VmHWM |'
    echo '|---|---|---|---|---|---|'
    local cap budget model render_budget
    while read -r cap budget render_budget; do
        for model in gears8-m.ply gears8.obj; do
            timed "$root/benches/capped.sh" --cold $model $cap "$bin/render" $model --compile-only --recompile --threads 1 \
                --memory $budget -o capped.outcrop
            if ((code == 99)); then cat log.txt; return 0; fi
            echo "| $cap | compile $model | $budget | $code | $cpu | $(resident) |"
            [[ $model == gears8-m.ply && $code == 0 ]] || continue
            timed "$root/benches/capped.sh" --cold capped.outcrop $cap "$bin/render" capped.outcrop "${view[@]}" --size 512 \
                --threads 2 --memory $render_budget --source disk -o capped-$cap.pfm --memory-log memory-$cap.csv
            echo "| $cap | render 512 x 512, all effects | $render_budget | $code | $cpu | $(resident) |"
        done
    done <<'CAPS'
256M 160MiB 160MiB
128M 96MiB 96MiB
64M 40MiB 40MiB
CAPS
    cmp capped-256M.pfm capped-128M.pfm && cmp capped-256M.pfm capped-64M.pfm && echo && echo 'The images are identical.'
    echo
}

compile() {
    echo '### Compile, one thread, processor time, median of five'
    echo
    echo '| model | budget | CPU s | M triangles/s |'
    echo '|---|---|---|---|'
    local model budget repetition
    for model in gears8.ply gears8.obj; do
        for budget in 1GiB 160MiB 96MiB; do
            for repetition in 1 2 3 4 5; do
                timed "$bin/render" $model --compile-only --recompile --threads 1 --memory $budget -o time.outcrop
                ((code == 0)) || { cat log.txt; return 1; }
                echo "$cpu"
            done >cpus.txt
            cpu=$(median <cpus.txt)
            echo "| $model | $budget | $cpu | $(rate "$cpu") |"
        done
        grep -E 'reading|bytes per triangle' log.txt | sed 's/^/<!-- /;s/$/ -->/'
    done
    echo
    echo '| threads | wall s, median of five (PLY, 1 GiB) |'
    echo '|---|---|'
    for threads in 1 2; do
        for repetition in 1 2 3 4 5; do
            timed "$bin/render" gears8.ply --compile-only --recompile --threads $threads --memory 1GiB -o time.outcrop
            echo "$wall"
        done | median | sed "s/.*/| $threads | & |/"
    done
    echo
}

image() {
    echo '### One image'
    echo
    picture() { # NAME OPTION...
        local name=$1
        shift
        timed "$bin/render" gears8-m.ply --compiled image.outcrop "${view[@]}" --size 512 -o "$name.pfm" "$@"
        ((code == 0)) || { cat log.txt; return 1; }
    }
    picture reference --recompile --threads 2 --memory 256MiB
    echo "Reference: 512 x 512, disk, 256 MiB, 2 threads, 64 KiB blocks, LZ4: $(sha256sum <reference.pfm | cut -c1-16)."
    echo
    echo '| differs in | image | wall s |'
    echo '|---|---|---|'
    local options
    while read -r options; do
        # shellcheck disable=SC2086 # options are words
        picture other $options
        if cmp -s reference.pfm other.pfm; then echo "| $options | identical | $wall |"; else echo "| $options | DIFFERENT | $wall |"; fi
    done <<'VARIANTS'
--memory 48MiB --threads 2
--memory 4GiB --threads 2
--memory 256MiB --threads 1
--memory 256MiB --source mmap
--memory 512MiB --source memory
--memory 256MiB --simd portable
--memory 256MiB --leaves indexed
--memory 256MiB --leaves expanded
--memory 256MiB --recompile --block-bytes 4KiB
--memory 256MiB --recompile --block-bytes 16KiB
--memory 256MiB --recompile --block-bytes 256KiB
--memory 256MiB --recompile --codec raw
--memory 256MiB --recompile --codec lzo
VARIANTS
    echo
}

touched() {
    echo '### How much of the model the standard view needs'
    echo
    "$bin/render" gears8.ply --compiled touched.outcrop "${view[@]}" --size 512 --memory 1GiB --recompile -o touched.png --stats touched.json \
        >touched.txt 2>&1
    grep -E '^(rays|blocks)' touched.txt | sed 's/^/    /'
    "$bin/render" gears8-m.ply --compiled touched-m.outcrop "${view[@]}" --size 512 --memory 1GiB --recompile -o touched-m.png \
        >touched.txt 2>&1
    echo '    with mirrors and glass:'
    grep -E '^(rays|blocks)' touched.txt | sed 's/^/    /'
    echo
}

failures() {
    echo '### Failures and what they say'
    echo
    echo '```'
    "$bin/gears" --n 1 -o small.ply >/dev/null
    echo '$ render missing.ply'
    "$bin/render" missing.ply 2>&1 || true
    echo '$ render small.ply -o /nowhere/small.png'
    "$bin/render" small.ply -o /nowhere/small.png 2>&1 | tail -1 || true
    head -c 300000 small.ply >cut.ply
    echo '$ render cut.ply (the file ends early)'
    "$bin/render" cut.ply 2>&1 | tail -1 || true
    "$bin/render" small.ply --compile-only --recompile -o bad.outcrop >/dev/null 2>&1
    printf '\x55' | dd of=bad.outcrop bs=1 seek=20000 conv=notrunc status=none
    echo '$ render bad.outcrop (one byte of a block changed)'
    "$bin/render" bad.outcrop --size 64 -o bad.png 2>&1 | tail -1 || true
    [[ ! -e bad.png ]] || echo 'an image was written'
    if ((EUID == 0)) && mkdir -p full && mount -t tmpfs -o size=8m none full 2>/dev/null; then
        echo '$ render gears8.ply --compile-only -o full/gears8.outcrop (a disk of 8 MiB)'
        "$bin/render" gears8.ply --compile-only -o full/gears8.outcrop 2>&1 | tail -1 || true
        echo "left behind: $(find full -type f | wc -l) files"
        umount full
    else
        echo '(a full disk: needs root to mount a small one)'
    fi
    echo '```'
    echo
}

for part in "${parts[@]}"; do
    case $part in
        caps | compile | image | touched | failures) "$part" ;;
        *) echo "unknown part: $part" >&2; exit 2 ;;
    esac
done
