# Every command block of the README, run as it stands there.
awk '/^```sh$/ {block = 1; next} /^```$/ {block = 0} block' README.md >target/readme.sh
cat target/readme.sh
bash -euxo pipefail target/readme.sh >target/readme.log 2>&1 || { tail -40 target/readme.log; exit 1; }
tail -5 target/readme.log
