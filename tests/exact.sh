#!/bin/bash
# exact.sh - DN_EXACT: exact.c built by every compiler here, at every level, in GNU mode (which contracts a b + c) for all
#   that this processor has and in ISO mode for the least, as C++, in 32 bits, and for other processors, under qemu: the
#   hashes must be the same. Then what the header must refuse, and that without its pragmas the hashes do differ
# usage   ./exact.sh                                 JOBS builds at once, 2 unless told; MISSING_OK=0 makes a compiler or
#         emulator that is not installed a failure (CI sets it), else it is a SKIP
# prints  a line per build and "exact: N passed, N failed, N skipped"
cd "$(dirname "$0")" || exit 2
JOBS=${JOBS:-2}
dir=$(mktemp -d) || exit 2
trap 'rm -rf "$dir"' EXIT
mkdir "$dir/tests"
cp exact.c test.h tiny.h "$dir/tests/"
grep -vE '^ *#pragma (GCC optimize|STDC FP_CONTRACT)' ../deformnet.h > "$dir/deformnet.h" # for the last check
names=()
# build NAME EMULATOR COMPILER FLAGS...: exact.c, in the background; the hashes in $dir/NAME.out, what went wrong in .rc
build()
{
   local name=$1 emulator=$2 source=exact.c language=c
   shift 2
   [[ $* == *-xc++* ]] && language=c++
   if [[ $name == bare-* ]]; then source=$dir/tests/exact.c; else names+=("$name"); fi
   while (($(jobs -rp | wc -l) >= JOBS)); do wait -n; done
   {
      if ! command -v "$1" > /dev/null; then echo "skip $1 is not installed"
      elif [[ -n $emulator ]] && ! command -v "$emulator" > /dev/null; then echo "skip $emulator is not installed"
      elif ! echo 'int main(void){return 0;}' | "$@" -x$language - -o "$dir/$name" -lm > /dev/null 2>&1; then echo "skip $* has no C library"
      elif ! "$@" "$source" -o "$dir/$name" -lm > "$dir/$name.log" 2>&1; then echo "fail does not compile"
      elif ! ${emulator:+$emulator} "$dir/$name" > "$dir/$name.log"; then echo "fail does not pass its own checks"
      else
         grep '^hash ' "$dir/$name.log" > "$dir/$name.out"
         echo ok
      fi
   } > "$dir/$name.rc" &
}
case $(uname -m) in
x86_64 | i?86) all="-march=native" narrow="-m32 -msse2 -mfpmath=sse" ;;
*) all="-mcpu=native" narrow= ;;
esac
for cc in gcc clang; do
   build $cc-O2-c99 "" $cc -std=c99 -O2
   for level in 0 1 2 3; do build $cc-O$level "" $cc -std=gnu11 -O$level $all; done
   [[ -n $narrow ]] && build $cc-O2-32 "" $cc -std=gnu11 -O2 $narrow
   build $cc-O2-c++ "" ${cc/gcc/g++} -xc++ -std=gnu++11 -O2 $all
done
# these have a fused multiply-add in every processor, or other bytes first, or numbers of 32 bits
for level in 0 3; do
   build aarch64-O$level qemu-aarch64 aarch64-linux-gnu-gcc -std=gnu11 -O$level -static
   build armhf-O$level qemu-arm arm-linux-gnueabihf-gcc -std=gnu11 -O$level -mfpu=neon-vfpv4 -static
   build riscv64-O$level qemu-riscv64 riscv64-linux-gnu-gcc -std=gnu11 -O$level -static
   build s390x-O$level qemu-s390x s390x-linux-gnu-gcc -std=gnu11 -O$level -march=z13 -static
done
# without the header's pragmas: a test that stays green then would prove nothing
build bare-aarch64 qemu-aarch64 aarch64-linux-gnu-gcc -std=gnu11 -O2 -static
build bare-clang "" clang -std=gnu11 -O1 $all
wait
passed=0 failed=0 skipped=0 reference=
pass() { passed=$((passed + 1)) && echo "PASS $1"; }
fail() { failed=$((failed + 1)) && echo "FAIL $1"; }
for name in "${names[@]}"; do
   read -r rc rest < "$dir/$name.rc"
   case $rc in
   ok)
      if (($(wc -l < "$dir/$name.out") < 44)); then fail "$name: printed too little"
      elif [[ -z $reference ]]; then reference=$name && pass "$name, the first:" && sed 's/^/     /' "$dir/$name.out"
      elif cmp -s "$dir/$reference.out" "$dir/$name.out"; then pass "$name: the same"
      else
         fail "$name: differs from $reference"
         diff "$dir/$reference.out" "$dir/$name.out" | grep '^>'
      fi ;;
   skip)
      if [[ ${MISSING_OK:-1} == 0 ]]; then fail "$name: $rest"
      else skipped=$((skipped + 1)) && echo "SKIP $name: $rest"; fi ;;
   *) fail "$name: $rest" && grep -v '^hash\|^ok' "$dir/$name.log" | head -n 5 ;;
   esac
done
# where products are fused, hashes without the pragmas must differ, but not that of the inputs, the first
for name in bare-aarch64 bare-clang; do
   read -r rc rest < "$dir/$name.rc"
   n=$([[ $rc == ok && -n $reference ]] && diff "$dir/$reference.out" "$dir/$name.out" | grep -c '^>')
   if [[ $rc == skip ]] || { [[ $name == bare-clang ]] && ! grep -qwE 'fma|asimd' /proc/cpuinfo; }; then skipped=$((skipped + 1)) && echo "SKIP $name: ${rest:-no fused multiply-add here}"
   elif ! cmp -s <(head -n 1 "$dir/$reference.out") <(head -n 1 "$dir/$name.out"); then fail "$name: the inputs need the header's pragmas"
   elif ((n < 10)); then fail "$name: without the header's pragmas only $n hashes differ: they show too little"
   else pass "$name: without the header's pragmas $n hashes differ"; fi
done
# what cannot be exact must not compile
printf '#define DN_EXACT\n#define DEFORMNET_IMPLEMENTATION\n#include "%s/deformnet.h"\n' "$(cd .. && pwd)" > "$dir/one.c"
refuse() # refuse NAME COMPILER FLAGS...
{
   local name=$1
   shift
   command -v "$1" > /dev/null || return
   "$@" -std=c99 -fsyntax-only "$dir/one.c" > "$dir/log" 2>&1
   if (($? != 0)) && grep -q 'error.*DN_EXACT' "$dir/log"; then pass "$name is refused"; else fail "$name is not refused"; fi
}
refuse gcc-fast-math gcc -ffast-math
refuse gcc-associative gcc -O2 -fassociative-math -fno-signed-zeros -fno-trapping-math
refuse gcc-reciprocal gcc -freciprocal-math
refuse clang-fast-math clang -ffast-math
refuse clang-finite clang -ffinite-math-only
if [[ -n $narrow ]]; then refuse gcc-x87 gcc -m32 -mfpmath=387 && refuse clang-x87 clang -m32 -mno-sse; fi
echo "exact: $passed passed, $failed failed, $skipped skipped"
((failed == 0 && passed >= 6))
