#!/usr/bin/env bash
# glTF files from elsewhere: `render` makes a picture of each or says clearly why not, and never panics, hangs or dies.
# Prints Markdown tables of counts and reasons; fails if a file did any of the latter.
#
#     benches/gltf_wild.sh [FOLDER]
#
# FOLDER (models/gltf without it; models/ is not part of the repository) is searched for .gltf and .glb files as deep as it goes. If it is not there it is
# made and filled from packages that hold such files, with `npm` and `apt-get`: whichever is there. What else is put into it, as a checkout of the
# Khronos sample assets, is tried too; a row of the table is a folder of FOLDER. Messages of every run are in FOLDER/log.txt. Time per file is bounded by two minutes.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
folder=${1-$root/models/gltf}

fetch() {
    mkdir -p "$folder"
    if command -v npm >/dev/null; then
        # Controllers and hands, as people export them for the web.
        mkdir -p "$folder/webxr"
        (cd "$folder/webxr" && npm pack --silent @webxr-input-profiles/assets@1.0.20 >/dev/null && tar xzf ./*.tgz && rm ./*.tgz)
    fi
    if command -v apt-get >/dev/null; then
        # Of every version and exporter, many malformed on purpose.
        mkdir -p "$folder/assimp"
        # As root apt-get would warn that it cannot do this as another user.
        (cd "$folder/assimp" && apt-get download --quiet=2 --option APT::Sandbox::User=root assimp-testmodels && dpkg-deb --extract ./*.deb . && rm ./*.deb)
    fi
}
[[ -d $folder ]] || fetch
folder=$(cd "$folder" && pwd)
(cd "$root" && cargo build --release --example render --features jpeg --quiet)
render=$root/target/release/examples/render

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
: >"$folder/log.txt"
: >"$scratch/outcomes"
while IFS= read -r -d '' file; do
    code=0
    rm -f "$scratch/picture.png"
    timeout --kill-after=5 120 "$render" "$file" --recompile --size 160x120 --memory 256MiB -o "$scratch/picture.png" \
        >"$scratch/out.txt" 2>"$scratch/err.txt" || code=$?
    { printf '== %s: %d\n' "$file" "$code"; cat "$scratch/out.txt" "$scratch/err.txt"; } >>"$folder/log.txt"
    # Warnings may come before it.
    message=$(grep -m1 '^error: ' "$scratch/err.txt" || true)
    if grep -q "panicked at" "$scratch/err.txt" || ((code >= 100)); then
        outcome=failed
    elif ((code == 0)) && [[ -s $scratch/picture.png ]]; then
        outcome=picture
    elif ((code != 0)) && [[ -n $message ]]; then
        outcome=refused
    else
        # Neither a picture nor a reason.
        outcome=failed
    fi
    below=${file#"$folder"/}
    # Without paths, so that reasons can be counted.
    reason=${message//"$file"/FILE}
    printf '%s\t%s\t%s\t%s\n' "${below%%/*}" "$outcome" "$below" "${reason//"${file%/*}"\//}" >>"$scratch/outcomes"
done < <(find "$folder" -type f \( -iname '*.gltf' -o -iname '*.glb' \) -print0 | sort -z)

[[ -s $scratch/outcomes ]] || { echo "gltf_wild: no .gltf or .glb file in $folder" >&2; exit 1; }
printf '| folder | files | pictures | refused with a reason | failed |\n|---|---|---|---|---|\n'
awk -F'\t' '
    { names[$1]; files[$1]++; count[$1, $2]++; files["all"]++; count["all", $2]++ }
    function row(name) { printf "| %s | %d | %d | %d | %d |\n", name, files[name], count[name, "picture"], count[name, "refused"], count[name, "failed"] }
    END { for (name in names) row(name); row("all") }' "$scratch/outcomes"
printf '\nImages of roughness or metalness change %d of the pictures.\n' "$(grep -c '^effect *simulated: finish maps' "$folder/log.txt" || true)"
printf '\n| files | reason |\n|---|---|\n'
awk -F'\t' '
    $2 == "refused" {
        sub(/^error: /, "", $4); gsub(/[0-9]+/, "N", $4); gsub(/\|/, "/", $4); reasons[$4]++ }
    END { for (reason in reasons) printf "| %d | %s |\n", reasons[reason], reason }' "$scratch/outcomes" | sort -t'|' -k2,2nr -k3
if awk -F'\t' '$2 == "failed" { print "failed: " $3 ": " $4; found = 1 } END { exit !found }' "$scratch/outcomes"; then
    exit 1
fi
