# Every command block of the pages below docs/ and of the boards' README, page by page, from the root. `cubectl` and
# `cubelab` are the programs of the stage test.
. .ci/debug-build.sh
. .ci/pages.sh
export PATH=$PWD/target/debug:$PATH
work=$PWD/target/tutorials
# Folders of results that the pages name: none is left from an earlier run.
grep -oh 'target/[a-z0-9-]*' docs/*.md docs/*/*.md | sort -u | grep -vE '^target/(debug|release|thumb.*)?$' | xargs rm -rf "$work"
mkdir -p "$work"
count=0
for page in docs/*.md docs/*/*.md firmware/boards/*.md; do
    [[ " ${pages_with_a_cell[*]} " != *" $page "* ]] || continue
    name=$(tr / - <<<"${page%.md}")
    awk -v stem="$work/$name" '
        /^```sh/ { n += 1; file = sprintf("%s-%02d.sh", stem, n); next }
        /^```$/ { file = "" }
        file { print > file }' "$page"
    for block in "$work/$name"-*.sh; do
        [ -e "$block" ] || continue
        count=$((count + 1))
        begun=$SECONDS
        bash -euo pipefail "$block" >"$block.log" 2>&1 </dev/null ||
            { cat "$block" "$block.log"; echo "$page: block $(basename "$block") failed"; exit 1; }
        printf '%-40s %4d s\n' "$(basename "$block")" $((SECONDS - begun))
    done
done
[ "$count" -ge 16 ] || { echo "only $count command blocks found"; exit 1; }
