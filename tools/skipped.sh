#!/usr/bin/env bash
# tools/skipped.sh: prints what the latest checks and tests skipped and why, from the files in
# target/skipped. A line in them is KIND, a tab, TEST, a tab, REASON.
set -euo pipefail
cd "$(dirname "$0")/.."
shopt -s nullglob
files=(target/skipped/*)
if [ ${#files[@]} -eq 0 ] || [ -z "$(cat "${files[@]}")" ]; then
    echo "nothing skipped"
    exit 0
fi
sort -u "${files[@]}" | awk -F '\t' '
    !($1 in tests) { order[++kinds] = $1 }
    !(($1, $2) in seen_test) { seen_test[$1, $2]; tests[$1]++ }
    !(($1, $3) in seen_reason) {
        seen_reason[$1, $3]
        if (++reasons[$1] <= 3) why[$1] = why[$1] "\n    " $3
    }
    END {
        for (i = 1; i <= kinds; i++) {
            kind = order[i]
            printf "SKIPPED: %s (%d):%s\n", kind, tests[kind], why[kind]
            if (reasons[kind] > 3) printf "    … and %d more\n", reasons[kind] - 3
        }
    }'
