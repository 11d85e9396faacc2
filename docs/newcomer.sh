#!/usr/bin/env bash
# The way of a newcomer: clone, make demo, open the report.
#
#     docs/newcomer.sh SOURCE FOLDER > docs/gallery/newcomer.txt
#
# SOURCE is the repository to clone, FOLDER a place that does not exist yet. The log shows each command, what it
# printed, its seconds and how it ended; the names of SOURCE and FOLDER and of the home folder are taken out.
set -euo pipefail
source=${1:?the repository to clone}
folder=${2:?a folder that does not exist yet}
[ ! -e "$folder" ] || { echo "$folder exists; name another one" >&2; exit 2; }

step() {
    local begin=$SECONDS code=0
    echo "\$ $*"
    "$@" 2>&1 || code=$?
    echo "[ended with $code after $((SECONDS - begin)) s]"
    echo
    return "$code"
}

report_is_whole() {
    local report=demo/result/report.html
    grep -q "<title>" "$report" && grep -q "</html>" "$report"
    if grep -Eq '(src|href)="https?:' "$report"; then echo "loads from the network"; return 1; fi
    echo "$report: $(wc -c < "$report") bytes, one file, nothing loaded from the network"
}

run() {
    step git clone --quiet "$source" "$folder"
    cd "$folder"
    step git log -1 --format=%h
    step make demo
    step report_is_whole
}

# Lines with file:/// are remarks of pip on where this machine keeps packages.
# pipefail hands on the code of the first step that failed.
run | sed -e '/file:\/\/\//d' -e "s#$folder#fg_orient#g" -e "s#$source#REPOSITORY#g" -e "s#$HOME#~#g"
