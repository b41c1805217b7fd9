#!/bin/sh
# The commands of docs/how-to/lesson.md, one after the other: Enter runs the next one, q ends.
# Simulated trials are shown once, at life speed. Run it in the folder of the clone:
#
#     source .venv/bin/activate
#     sh examples/lesson.sh
set -u
logs=logs/lesson
rm -rf "$logs"

step() {
    printf '\n$ %s\n[Enter: run it, s: skip it, q: end] ' "$*"
    read -r answer || exit 0
    case $answer in
        q) exit 0 ;;
        s) return ;;
    esac
    "$@"
}

section() {
    printf '\n=== %s ===\n' "$1"
}

section '1. One signal, three robots'
step tetractl play experiments/three_m3pi.yaml

section '2. What if they turned alike?'
step tetractl run experiments/three_m3pi.yaml --trials 1 --rate 1 --out "$logs/equal" \
    --set robots.green.a=4 --set robots.red.a=4 \
    --set robots.green.speed=200 --set robots.red.speed=200 --set controller.time_limit=10

section '3. The obstacle moves'
step tetractl run experiments/three_m3pi.yaml --trials 1 --rate 1 --out "$logs/moved" \
    --set obstacles.0.bottom=1400

section '4. The signal comes late'
step tetractl run experiments/three_m3pi.yaml --trials 1 --rate 1 --out "$logs/delayed" \
    --set plant.dead_time=0.15 --set controller.estimate=false --set controller.time_limit=20
step tetractl run experiments/three_m3pi.yaml --trials 1 --rate 1 --out "$logs/given" \
    --set plant.dead_time=0.15 --set controller.estimate=false --set controller.dead_time=0.15
step tetractl run experiments/three_m3pi.yaml --trials 1 --rate 1 --out "$logs/finds" \
    --set plant.dead_time=0.15

section '5. Nearly real robots'
step tetractl stats logs/blind logs/learns

section '6. A last question, and its answer'
step tetractl run experiments/three_m3pi.yaml --trials 1 --rate 1 --out "$logs/drive" \
    --set robots.green.a=4 --set robots.red.a=4 --set controller.time_limit=10
step tetractl run experiments/three_m3pi.yaml --trials 1 --rate 1 --out "$logs/turn" \
    --set robots.green.speed=200 --set robots.red.speed=200
