# The live view and a report in a real browser (Debian's Chromium): what the page shows is what the recording holds, its stop
# button halts; what a report shows under the pointer is what recording and plan hold; of each kind of report every text and curve of
# its data is in the page; its layout on desktop, phone and paper.
. .ci/venv.sh live tests/interop/live/requirements.txt
. .ci/debug-build.sh
if ! command -v chromium >/dev/null; then
    sudo=$([ "$(id -u)" -eq 0 ] || echo sudo)
    $sudo apt-get update -q
    $sudo apt-get install -y -q --no-install-recommends chromium
fi
out=target/live-stage
rm -rf "$out" && mkdir -p "$out/page" "$out/report" "$out/layout" "$out/end"
python tests/interop/live/check_page.py target/debug/cubectl "$out/page"
python tests/interop/live/check_report.py target/debug/cubectl "$out/report"
python tests/interop/live/check_layout.py target/debug/cubectl "$out/layout"
python tests/interop/live/check_end.py target/debug/cubectl "$out/end"
