#!/usr/bin/env bash
# Makes one picture by processes that Slurm starts, under a Slurm of its own on this machine: as nodes over TCP with a host file made from
# the job's variables (the batch script of docs/cluster.md), and the same with a worker killed in mid-render; as ranks of MPI, where the
# program is built with it; and with launchers that do not fit, which must be told so. Each picture is compared, bit by bit, with that of
# one process.
#
#     benches/slurm.sh CLUSTER_RENDER
#
# CLUSTER_RENDER is the built example. The exit code is 99 if there can be no Slurm here (needs root, slurmctld, slurmd and munged; Debian:
# slurm-wlm munge), or 2 for a mistake in the call. A Slurm that runs on this machine is not touched, and everything is removed at the end.
set -euo pipefail

fail() { # CODE MESSAGE
    printf 'slurm: %s\n' "$2" >&2
    exit "$1"
}

(($# == 1)) || fail 2 "usage: slurm.sh CLUSTER_RENDER"
render=$(realpath "$1")
[[ -x $render ]] || fail 2 "$1 is no program; build it: cargo build --release --example cluster_render"
((EUID == 0)) || fail 99 "a Slurm of one's own needs root here: run with sudo"
PATH=$PATH:/usr/sbin:/sbin
for program in munged slurmctld slurmd srun sbatch scontrol; do
    command -v "$program" >/dev/null || fail 99 "no $program: install Slurm and MUNGE (Debian: slurm-wlm munge)"
done

scratch=$(mktemp -d)
clean() {
    # Its jobs first, since the daemon that watches them does not end them when it ends.
    if [[ -e $scratch/running ]]; then
        scancel --full --user root 2>/dev/null && sleep 1 || true
    fi
    # Those that this script has started and that still run.
    for job in $(jobs -p); do kill "$job" 2>/dev/null || true; done
    wait 2>/dev/null || true
    rm -rf "$scratch"
}
trap clean EXIT
# Every way to be killed by a signal passes through the line above, too.
trap 'exit 130' INT TERM

host=$(hostname -s)
# Below what the system gives to those who ask for any port.
port=$((20000 + $$ % 10000))
mkdir "$scratch"/{state,spool,work}
head -c 1024 /dev/urandom >"$scratch/munge.key"
chmod 600 "$scratch/munge.key"
# More processors than there are, so that all of a job's processes run at one time; nothing is bound or accounted for.
cat >"$scratch/slurm.conf" <<CONF
ClusterName=outcrop
SlurmctldHost=$host
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
CredType=cred/munge
AuthInfo=socket=$scratch/munge.socket
SlurmctldPort=$port
SlurmdPort=$((port + 1))
SlurmctldPidFile=$scratch/slurmctld.pid
SlurmdPidFile=$scratch/slurmd.pid
StateSaveLocation=$scratch/state
SlurmdSpoolDir=$scratch/spool
SlurmctldLogFile=$scratch/slurmctld.log
SlurmdLogFile=$scratch/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SwitchType=switch/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SlurmdParameters=config_overrides
ReturnToService=2
MpiDefault=none
NodeName=$host CPUs=8 State=UNKNOWN
PartitionName=all Nodes=$host Default=YES State=UP
CONF
# Where the machine has its control groups from no init system.
echo "IgnoreSystemd=yes" >"$scratch/cgroup.conf"
export SLURM_CONF=$scratch/slurm.conf

munged --foreground --force --key-file="$scratch/munge.key" --socket="$scratch/munge.socket" --pid-file="$scratch/munged.pid" \
    --log-file="$scratch/munged.log" --seed-file="$scratch/munged.seed" >"$scratch/munged.out" 2>&1 &
munged=$!
for _ in {1..100}; do
    [[ -S $scratch/munge.socket ]] && break
    kill -0 "$munged" 2>/dev/null || break
    sleep 0.05
done
[[ -S $scratch/munge.socket ]] || fail 99 "no munged here: $(tail -n 1 "$scratch/munged.out")"
slurmctld -D -c >"$scratch/slurmctld.out" 2>&1 &
slurmd -D -c >"$scratch/slurmd.out" 2>&1 &
for _ in {1..200}; do
    [[ $(sinfo --noheader --format=%T 2>/dev/null) != idle ]] || break
    sleep 0.1
done
[[ $(sinfo --noheader --format=%T 2>/dev/null) == idle ]] ||
    fail 99 "no Slurm here: $(tail -q -n 1 "$scratch/slurmctld.log" "$scratch/slurmd.log" 2>/dev/null | paste -sd ';')"
touch "$scratch/running"
echo "$(slurmd -V) on $host"

cd "$scratch/work"
"$render" --new-key key
"$render" --small --workers 1 --readers 0 -o alone.png >/dev/null
compiled=$(echo cluster-gears*.outcrop)

identical() { # NAME
    grep "identical to the picture of one process" "$1.log" || { cat "$1.log"; fail 1 "$1: another picture, or none"; }
}

# As in docs/cluster.md, but a job of one node, which stands for all that the list has there. The pictures are small: a task may come when
# its picture is done, and then does not wait long for a coordinator. So the exit code of the job says nothing.
batch() { # NAME OPTION...
    local name=$1
    shift
    cat >"$name.sh" <<BATCH
#!/bin/bash
#SBATCH --no-kill --nodes=1 --ntasks=4 --ntasks-per-node=4 --output=$name.log
mapfile -t nodes < <(scontrol show hostnames "\$SLURM_JOB_NODELIST")
nodes=("\${nodes[0]}" "\${nodes[0]}" "\${nodes[0]}" "\${nodes[0]}")
{
    echo "\${nodes[0]}:$((port + 2)) coordinator"
    echo "\${nodes[1]}:$((port + 3)) reader"
    printf '%s worker\n' "\${nodes[@]:2}"
} > $name.hosts
srun --no-kill $render $compiled --hosts $name.hosts --key-file key --patience 5 --verify --verbose -o $name.png $*
BATCH
    sbatch --parsable "$name.sh" >"$name.job"
}
finish() { # NAME
    local job
    job=$(<"$1.job")
    while [[ -n $(squeue --noheader --jobs "$job" --states PENDING,CONFIGURING,RUNNING,COMPLETING 2>/dev/null) ]]; do sleep 0.2; done
    scontrol show job "$job" | grep -o "JobState=[A-Z_]*\|ExitCode=[0-9:]*" | paste -sd ' '
}

echo "TCP, a host file from Slurm's variables: coordinator, reader, 2 workers"
batch tcp --size 800x600
finish tcp
identical tcp
grep "nodes joined" tcp.log

echo "the same, and a worker is killed in mid-render"
# Large enough that there is much left of it when the worker is found.
batch killed --size 2400x1800 --spp 4
for _ in {1..600}; do
    (($(stat -c %s killed.checkpoint 2>/dev/null || echo 0) < 500000)) || break
    sleep 0.05
done
# A task that is a worker, by what Slurm has told it.
victim=
for task in $(scontrol listpids "$(<killed.job).0" 2>/dev/null | awk '$5 == 2 {print $1}'); do
    victim=$task
done
[[ -n $victim ]] && kill -KILL "$victim" || { cat killed.log; fail 1 "killed: there is no worker that could be killed"; }
# The step has an exit code that says it; the picture is there.
finish killed
identical killed
grep "joined, [1-9][0-9]* were lost" killed.log || { cat killed.log; fail 1 "killed: nobody was lost"; }

library=$(ldd "$render" | awk '/libmpi(ch)?\.so/ {print $1; exit}')
case $library in
libmpich* | libmpi.so.12) fitting=pmi2 other=pmix ;;
libmpi*) fitting=pmix other= ;;
*)
    echo "built without MPI: no ranks under srun"
    fitting= other=
    ;;
esac
if [[ -n $fitting ]]; then
    export OMPI_MCA_btl_vader_single_copy_mechanism=none
    if ! srun --mpi=list 2>&1 | grep -qw "$fitting"; then
        echo "this Slurm has no $fitting: no ranks of $library under srun"
    else
        echo "ranks of MPI ($library): srun --mpi=$fitting -n 4"
        srun --mpi="$fitting" -n 4 "$render" "$compiled" --readers 1 --size 800x600 --verify -o ranks.png >ranks.log 2>&1 ||
            { cat ranks.log; fail 1 "ranks: the job failed"; }
        identical ranks
        cmp ranks.png tcp.png
        echo "    the picture that TCP brought, too"
    fi
fi

# Nobody renders the whole by himself because nobody told him of the others.
echo "started several times, with nothing that lets them find each other"
for launch in none $other; do
    code=0
    timeout 60 srun --mpi="$launch" -n 3 "$render" "$compiled" -o lost.png >"lost-$launch.log" 2>&1 || code=$?
    ((code != 0 && code != 124)) && [[ ! -e lost.png ]] || { cat "lost-$launch.log"; fail 1 "--mpi=$launch: it did not fail"; }
    grep -m 1 "started several times\|MPI knows of this process alone" "lost-$launch.log" ||
        { cat "lost-$launch.log"; fail 1 "--mpi=$launch: it did not say why"; }
done
echo "under Slurm: all pictures identical"
