#!/usr/bin/env bash
# Makes one picture by hosts of their own on this machine: network namespaces on a bridge, each with an address, and with a delay and a
# rate of its line. Then cuts a worker's line in mid-render. Each picture is compared, bit by bit, with that of one process.
#
#     benches/namespaces.sh CLUSTER_RENDER [RATE [DELAY]]
#
# CLUSTER_RENDER is the built example. RATE and DELAY are in the words of tc (100mbit 2ms). The exit code is 99 if there can be no such hosts
# here (needs root, iproute2, and a kernel with network namespaces, veth, bridges and rate limits), or 2 for a mistake in the call.
# Where the kernel has no netem there is no delay, and it says so. Everything is removed at the end.
set -euo pipefail

fail() { # CODE MESSAGE
    printf 'namespaces: %s\n' "$2" >&2
    exit "$1"
}

(($# >= 1)) || fail 2 "usage: namespaces.sh CLUSTER_RENDER [RATE [DELAY]]"
render=$(realpath "$1")
[[ -x $render ]] || fail 2 "$1 is no program; build it: cargo build --release --example cluster_render"
rate=${2-100mbit}
delay=${3-2ms}
((EUID == 0)) || fail 99 "network namespaces need root here: run with sudo"
command -v ip >/dev/null && command -v tc >/dev/null || fail 99 "no ip or tc: install iproute2"

tag=outcrop$$
scratch=$(mktemp -d)
hosts=(coordinator reader worker1 worker2)
clean() {
    # Those that this script has started and that still run.
    for job in $(jobs -p); do kill "$job" 2>/dev/null || true; done
    wait 2>/dev/null || true
    for host in bridge "${hosts[@]}"; do ip netns del "$tag-$host" 2>/dev/null || true; done
    rm -rf "$scratch"
}
trap clean EXIT
# Every way to be killed by a signal passes through the line above, too.
trap 'exit 130' INT TERM

ip netns add "$tag-bridge" 2>"$scratch/why" || fail 99 "no network namespaces here: $(cat "$scratch/why")"
{ ip -n "$tag-bridge" link add bridge type bridge && ip -n "$tag-bridge" link set bridge up; } 2>"$scratch/why" ||
    fail 99 "no bridges here: $(cat "$scratch/why")"
shaping=
number=0
for host in "${hosts[@]}"; do
    number=$((number + 1))
    ip netns add "$tag-$host"
    ip -n "$tag-$host" link add line type veth peer name "port$number" netns "$tag-bridge" 2>"$scratch/why" ||
        fail 99 "no veth here: $(cat "$scratch/why")"
    ip -n "$tag-bridge" link set "port$number" master bridge up
    ip -n "$tag-$host" addr add "10.97.0.$number/24" dev line
    ip -n "$tag-$host" link set line up
    ip -n "$tag-$host" link set lo up
    # What the host sends.
    if tc -n "$tag-$host" qdisc add dev line root netem delay "$delay" rate "$rate" 2>/dev/null; then
        shaping="$rate and $delay each way, by netem"
    elif tc -n "$tag-$host" qdisc add dev line root tbf rate "$rate" burst 64kb latency 50ms 2>"$scratch/why"; then
        shaping="$rate by tbf, no delay (this kernel has no netem)"
    else
        fail 99 "no rate limits here: $(cat "$scratch/why")"
    fi
done
echo "hosts: ${hosts[*]}; lines: $shaping"

cd "$scratch"
on() { # HOST COMMAND...
    local host=$1
    shift
    ip netns exec "$tag-$host" "$@"
}
"$render" --new-key key
"$render" --small --workers 1 --readers 0 -o alone.png >/dev/null
compiled=$(echo cluster-gears*.outcrop)

run() { # NAME SIZE OPTION-OF-THE-COORDINATOR...
    local name=$1 size=$2
    shift 2
    on coordinator "$render" --role coordinator "$compiled" --listen 10.97.0.1:7100 --key-file key --workers 2 --size "$size" \
        --verify --verbose -o "$name.png" "$@" >"$name.log" 2>&1 &
    coordinator=$!
    local node=(--connect 10.97.0.1:7100 --key-file key)
    on reader "$render" --role reader "$compiled" --listen 10.97.0.2:7101 --advertise 10.97.0.2:7101 "${node[@]}" >/dev/null 2>&1 &
    # Neither has the file: all blocks come over the lines.
    on worker1 "$render" --role worker "${node[@]}" >"$name-worker1.log" 2>&1 &
    worker=$!
    on worker2 "$render" --role worker "${node[@]}" --keep "$name-copy.outcrop" >"$name-worker2.log" 2>&1 &
}
finish() { # NAME
    wait "$coordinator" || { cat "$1.log"; fail 1 "$1: the coordinator failed"; }
    grep "identical to the picture of one process" "$1.log" || { cat "$1.log"; fail 1 "$1: another picture"; }
}

run four-hosts 320x240 --readers 1
finish four-hosts
wait "$worker" || { cat four-hosts-worker1.log; fail 1 "a worker failed"; }
cat four-hosts-worker1.log

# The line of a worker is cut in mid-render. Its cells go to the other, at the latest after ten seconds of silence.
run cut-off 1600x1200 --readers 1
while kill -0 "$coordinator" 2>/dev/null && (($(stat -c %s cut-off.checkpoint 2>/dev/null || echo 0) < 500000)); do sleep 0.05; done
ip -n "$tag-worker1" link set line down
kill -0 "$coordinator" 2>/dev/null || fail 1 "the render was over before a line could be cut"
finish cut-off
# It has not heard that the picture is done.
kill -0 "$worker" 2>/dev/null || fail 1 "the worker whose line was cut has ended like the others"
kill "$worker"
echo "hosts in network namespaces: all pictures identical"
