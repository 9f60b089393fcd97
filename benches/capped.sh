#!/usr/bin/env bash
# Runs a command under a hard memory cap that counts everything, the page cache included (a Linux control group, v1 or
# v2, without swap), and says how much it took and whether the cap killed it.
#
#     benches/capped.sh [--cold FILE]... LIMIT COMMAND [ARGUMENT]...
#
# LIMIT is in bytes or has a binary unit: 64M, 256MiB, 2G. --cold drops the cached pages of FILE first, so that the run
# reads it from disk and is charged for its pages. The exit code is the command's (137 if the cap killed any part of it), or 99 if no
# cap can be set here (needs root and the memory controller), or 2 for a mistake in the call.
#
# The peak of a group reaches the cap whenever files are read: it shows that a run survives, not what it needs. What it
# needs is its anonymous memory.
set -euo pipefail

fail() { # CODE MESSAGE
    printf 'capped: %s\n' "$2" >&2
    exit "$1"
}

cold=()
while [[ ${1-} == --cold ]]; do
    [[ -r ${2-} ]] || fail 2 "--cold: cannot read '${2-}'"
    cold+=("$2")
    shift 2
done
(($# >= 2)) || fail 2 "usage: capped.sh [--cold FILE]... LIMIT COMMAND [ARGUMENT]..."
limit=$1
shift
[[ $limit =~ ^([0-9]+)([kKmMgG]?)(i?[bB])?$ ]] || fail 2 "'$limit' is not an amount of memory: write 256M, 2G or bytes"
case ${BASH_REMATCH[2]} in
    k | K) shift_bits=10 ;;
    m | M) shift_bits=20 ;;
    g | G) shift_bits=30 ;;
    *) shift_bits=0 ;;
esac
limit_bytes=$((BASH_REMATCH[1] << shift_bits))

root=/sys/fs/cgroup
((EUID == 0)) || fail 99 "a memory cap needs root here: run with sudo"
if [[ -f $root/cgroup.controllers ]]; then
    version=2
    grep -qw memory "$root/cgroup.controllers" || fail 99 "the control groups of this machine have no memory controller"
    grep -qw memory "$root/cgroup.subtree_control" || { echo +memory >"$root/cgroup.subtree_control"; } 2>/dev/null ||
        fail 99 "the memory controller cannot be handed to a new group here (inside a container?)"
    group=$root/outcrop-capped-$$
elif [[ -d $root/memory ]]; then
    version=1
    group=$root/memory/outcrop-capped-$$
else
    fail 99 "no control groups with a memory controller under $root"
fi
mkdir "$group" 2>/dev/null || fail 99 "cannot make a control group under ${group%/*}"

# shellcheck disable=SC2317 # called by the trap
clean_up() {
    local process
    for _ in 1 2 3 4 5 6 7 8 9 10; do
        while read -r process; do
            kill -KILL "$process" 2>/dev/null || true
        done <"$group/cgroup.procs" || true
        # Fails until the last process is gone.
        rmdir "$group" 2>/dev/null && return
        sleep 0.1
    done
    printf 'capped: %s could not be removed\n' "$group" >&2
}
trap clean_up EXIT
trap 'exit 130' INT
trap 'exit 143' TERM HUP

set_limit() { # FILE VALUE
    { echo "$2" >"$group/$1"; } 2>/dev/null || fail 99 "cannot set $1 in $group"
}
if ((version == 2)); then
    set_limit memory.max "$limit_bytes"
    # Without swap accounting there is no such file, and without swap no need for it.
    [[ ! -f $group/memory.swap.max ]] || set_limit memory.swap.max 0
else
    set_limit memory.limit_in_bytes "$limit_bytes"
    [[ ! -f $group/memory.memsw.limit_in_bytes ]] || set_limit memory.memsw.limit_in_bytes "$limit_bytes"
fi

for file in ${cold[@]+"${cold[@]}"}; do
    # Dirty pages stay cached until they are written.
    sync "$file"
    dd if="$file" iflag=nocache count=0 status=none
done

code=0
# The command moves itself into the group before it starts, so that nothing of it escapes the count. In the background
# and waited for, so that a signal ends the wait.
# shellcheck disable=SC2016 # $0 and $@ are for the inner shell
bash -c 'echo $$ >"$0/cgroup.procs" || exit 99; exec "$@"' "$group" "$@" <&0 &
wait $! || code=$?

read_number() { # FILE
    cat "$group/$1" 2>/dev/null || echo 0
}
if ((version == 2)); then
    peak_bytes=$(read_number memory.peak)
    kills=$(awk '$1 == "oom_kill" { print $2 }' "$group/memory.events")
else
    peak_bytes=$(read_number memory.max_usage_in_bytes)
    kills=$(awk '$1 == "oom_kill" { print $2 }' "$group/memory.oom_control")
fi
# Kernels before 5.19 do not tell the peak of a v2 group.
((peak_bytes > 0)) && peak="$((peak_bytes >> 20)) MiB" || peak="not known"
verdict="not killed"
if ((${kills:-0} > 0)); then
    verdict="KILLED BY THE CAP"
    # Also where only a child of the command was killed and the command did not mind.
    code=137
fi
printf 'capped: limit %s MiB, peak %s, exit %s, %s\n' "$((limit_bytes >> 20))" "$peak" "$code" "$verdict" >&2
exit "$code"
