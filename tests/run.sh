#!/bin/bash
# run.sh - runs the tests that the Makefile built, prints what they print, adds up what they report
# usage   ./run.sh BUILD "NAMES" "KINDS"     kinds: plain sanitized nosimd threads scripts
# A program's last summary counts: "name: 12 passed, 0 failed", "3 tests, 12 checks, 0 failed" or "12 inputs, ...".
# A program that is missing, that says nothing, that crashes, hangs or exits with an error counts as one failure at least.
cd "$(dirname "$0")" || exit 2
build=$1 names=$2 kinds=$3
limit=${TEST_SECONDS:-600}
passed=0 failed=0 bad=()
export ASAN_OPTIONS=${ASAN_OPTIONS:-allocator_may_return_null=1:detect_leaks=1} UBSAN_OPTIONS=print_stacktrace=1
mkdir -p "$build/log"

# one TITLE COMMAND...
one()
{
   local title=$1 log=$build/log/${1//[ \/]/-} start=$SECONDS rc p=0 f=0 line
   shift
   echo "=== $title"
   timeout -k 10 "$limit" "$@" > "$log" 2>&1
   rc=$?
   cat "$log"
   line=$(grep -E '[0-9]+ (checks|passed|inputs)(, | \()' "$log" | tail -n 1)
   if [[ $line =~ ([0-9]+)\ passed.*[^0-9]([0-9]+)\ failed ]]; then p=${BASH_REMATCH[1]} f=${BASH_REMATCH[2]}
   elif [[ $line =~ ([0-9]+)\ checks,\ ([0-9]+)\ failed ]]; then f=${BASH_REMATCH[2]} p=$((BASH_REMATCH[1] - f))
   elif [[ $line =~ ([0-9]+)\ inputs ]]; then p=${BASH_REMATCH[1]} # a fuzzer that lived
   else echo "FAIL $title: no summary" && f=1
   fi
   if ((p == 0 && f == 0)); then echo "FAIL $title: checked nothing" && f=1; fi
   if ((rc != 0 && f == 0)); then
      f=1
      ((rc == 124 || rc == 137)) && echo "FAIL $title: still running after $limit s" || echo "FAIL $title: exit code $rc"
   fi
   echo "    $title: $p passed, $f failed ($((SECONDS - start)) s)"
   passed=$((passed + p)) failed=$((failed + f))
   ((f)) && bad+=("$title")
   return 0
}
program() # program KIND NAME ARGUMENTS...
{
   local file=$build/$1/$2
   if [[ -x $file && $file -nt $2.c ]]; then one "$2 ($1)" "$file" "${@:3}"
   else
      echo "=== $2 ($1)"
      echo "FAIL $2 ($1): did not build, or its source has changed since"
      failed=$((failed + 1)) bad+=("$2 ($1)")
   fi
}
for kind in $kinds; do
   case $kind in
   plain | sanitized | nosimd)
      for name in $names; do
         arguments=()
         [[ $name == golden && $kind == plain ]] && arguments=(--every-kernel data/golden/*.safetensors)
         [[ $name == golden && $kind != plain ]] && arguments=(--brief data/golden/*.safetensors)
         program $kind "$name" "${arguments[@]}"
      done ;;
   threads) program threads invariance threads ;;
   scripts)
      for script in *.sh; do
         [[ $script == run.sh ]] || one "${script%.sh}" "./$script"
      done ;;
   esac
done
echo
for title in "${bad[@]}"; do echo "FAILED: $title"; done
echo "$passed passed, $failed failed"
((failed == 0 && passed > 0))
