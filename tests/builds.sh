#!/bin/bash
# builds.sh - every way in which the header is meant to be compiled, strictly and without a warning; and the tests that
# depend on the machine run once more in the odd ones (32 bits, x87, unsigned char, no SIMD, another locale)
# usage   ./builds.sh [part of a build's name]       JOBS compiles at once, 2 unless told; MISSING_OK=0 makes a compiler
#         that is not installed a failure (CI sets it), else it is a SKIP
# prints  a line per build and "builds: N passed, N failed, N skipped"
cd "$(dirname "$0")" || exit 2
only=$1
JOBS=${JOBS:-2}
dir=$(mktemp -d) || exit 2
trap 'rm -rf "$dir"' EXIT
W="-Wall -Wextra -Wpedantic -Werror -Wconversion -Wsign-conversion -Wshadow -Wdouble-promotion -Wundef -Wstrict-aliasing=2"
printf '#define DEFORMNET_IMPLEMENTATION\n#include "deformnet.h"\n#include "deformnet.h"\n' > "$dir/one.c"
# a user's file and the implementation's: the declarations alone must do for the first
cat > "$dir/user.c" <<'E'
#include "deformnet.h"
int user(const dn_model *m);
int user(const dn_model *m)
{
   dn_model_info info;
   dn_model_describe(m, &info);
   return (int)info.joints + DN_VERSION;
}
E
cp ../deformnet.h "$dir/"
cp "$dir/one.c" "$dir/one.cpp"
cp "$dir/user.c" "$dir/user.cpp"

# build NAME FILE COMMAND...: in the background, JOBS at a time; its outcome in $dir/NAME.rc and .log
names=()
build()
{
   local name=$1 file=$2
   shift 2
   [[ $name == *"$only"* ]] || return
   names+=("$name")
   while (($(jobs -rp | wc -l) >= JOBS)); do wait -n; done
   if ! command -v "$1" > /dev/null; then echo "skip $1 is not installed" > "$dir/$name.rc"; return; fi
   {
      "$@" -I"$dir" -c "$dir/$file" -o "$dir/$name.o" > "$dir/$name.log" 2>&1
      echo $? > "$dir/$name.rc"
   } &
}
# Flow analysis needs -O1 or more; what only differs in language or configuration is read at -O0, which is quick.
for cc in gcc clang; do
   build $cc-c99 one.c $cc -std=c99 $W -O2
   build $cc-c11 one.c $cc -std=c11 $W -O0
   build $cc-c++11 one.cpp ${cc/gcc/g++} -xc++ -std=c++11 $W -O1
   build $cc-c99-user user.c $cc -std=c99 $W -O1
   build $cc-c++11-user user.cpp ${cc/gcc/g++} -xc++ -std=c++11 $W -O1
   build $cc-c99-m32 one.c $cc -std=c99 $W -O1 -m32
   build $cc-no-simd one.c $cc -std=c99 $W -O1 -DDN_NO_SIMD
   build $cc-static one.c $cc -std=c99 $W -O0 -DDEFORMNET_STATIC
   build $cc-static-c++ one.cpp ${cc/gcc/g++} -xc++ -std=c++11 $W -O0 -DDEFORMNET_STATIC
   build $cc-no-stdio one.c $cc -std=c99 $W -O0 -DDN_NO_STDIO
   build $cc-exact one.c $cc -std=c99 $W -O0 -DDN_EXACT
   build $cc-native one.c $cc -std=c99 $W -O0 -march=native
done
build clang-weverything one.c clang -std=c99 -Weverything -Werror -O0 -Wno-padded -Wno-disabled-macro-expansion -Wno-declaration-after-statement \
   -Wno-float-equal -Wno-unsafe-buffer-usage -Wno-pre-c11-compat -Wno-unknown-warning-option -Wno-switch-enum -Wno-switch-default -Wno-covered-switch-default \
   -Wno-comma -Wno-missing-prototypes -Wno-cast-align -Wno-cast-qual -Wno-bad-function-cast -Wno-reserved-identifier -Wno-vla -Wno-c++98-compat \
   -Wno-documentation -Wno-documentation-unknown-command -Wno-tautological-unsigned-zero-compare
build gcc-c++20 one.cpp g++ -std=c++20 $W -O0
build gcc-Os one.c gcc -std=c99 $W -Os
build gcc-exact-all-off-m32 one.c gcc -std=c99 $W -O1 -m32 -msse2 -mfpmath=sse -DDN_EXACT -DDEFORMNET_STATIC -DDN_NO_STDIO
build gcc-O3 one.c gcc -std=c99 $W -O3
build gcc-O0-ndebug one.c gcc -std=c99 $W -O0 -DNDEBUG
build gcc-unsigned-char one.c gcc -std=c99 $W -O0 -funsigned-char
build gcc-fast-math one.c gcc -std=c99 $W -O1 -ffast-math
build gcc-x87 one.c gcc -std=c99 $W -O1 -m32 -mfpmath=387 -mno-sse
build gcc-avx512 one.c gcc -std=c99 $W -O1 -mavx512f -mavx512vl -mfma
build gcc-pic-hidden one.c gcc -std=c99 $W -O0 -fPIC -fvisibility=hidden
build gcc-all-off-m32 one.c gcc -std=c99 $W -O1 -m32 -DDEFORMNET_STATIC -DDN_NO_SIMD -DDN_NO_STDIO
build gcc-more-warnings one.c gcc -std=gnu11 $W -O1 -Wformat=2 -Wnull-dereference -Wvla -Wpointer-arith -Wwrite-strings
build mingw-c99 one.c x86_64-w64-mingw32-gcc -std=c99 $W -O1
build mingw-c++11 one.cpp x86_64-w64-mingw32-g++ -std=c++11 $W -O0
build mingw-m32 one.c i686-w64-mingw32-gcc -std=c99 $W -O0
printf '#include <windows.h>\n#define DEFORMNET_IMPLEMENTATION\n#include "deformnet.h"\n' > "$dir/windows.c" # whose macros take near, far, small
build mingw-windows.h windows.c x86_64-w64-mingw32-gcc -std=c99 -Wall -Wextra -Werror -O0
build aarch64-c99 one.c aarch64-linux-gnu-gcc -std=c99 $W -O1
# clang knows other machines even without their libraries; the few headers needed are declared here
mkdir "$dir/bare"
echo '#include <stddef.h>
void *memcpy(void *, const void *, size_t); void *memmove(void *, const void *, size_t); void *memset(void *, int, size_t);
int memcmp(const void *, const void *, size_t); size_t strlen(const char *); int strcmp(const char *, const char *);
int strncmp(const char *, const char *, size_t); char *strchr(const char *, int);' > "$dir/bare/string.h"
echo 'void *malloc(__SIZE_TYPE__); void free(void *);' > "$dir/bare/stdlib.h"
echo '#define assert(x) ((void)(x))' > "$dir/bare/assert.h"
echo 'float sqrtf(float), fabsf(float), sinf(float), cosf(float); double sqrt(double), fabs(double);' > "$dir/bare/math.h"
for target in aarch64-linux-gnu armv7-linux-gnueabihf powerpc64-linux-gnu s390x-linux-gnu riscv64-linux-gnu mips-linux-gnu wasm32-unknown-unknown; do
   build clang-${target%%-*}-bare one.c clang --target=$target -ffreestanding -std=c99 $W -O0 -DDN_NO_STDIO -isystem "$dir/bare"
done
build clang-wasm32-simd-bare one.c clang --target=wasm32-unknown-unknown -msimd128 -ffreestanding -std=c99 $W -O0 -DDN_NO_STDIO -isystem "$dir/bare"
wait

passed=0 failed=0 skipped=0
for name in "${names[@]}"; do
   rc=$(cat "$dir/$name.rc" 2> /dev/null || echo 1)
   if [[ $rc == 0 ]]; then echo "PASS $name" && ((++passed))
   elif [[ $rc == skip* && ${MISSING_OK:-1} == 1 ]]; then echo "SKIP $name:${rc#skip}" && ((++skipped))
   elif grep -q "No available targets are compatible\|unable to create target\|unknown target" "$dir/$name.log" 2> /dev/null; then echo "SKIP $name: this clang lacks the target" && ((++skipped))
   else
      echo "FAIL $name"
      ((++failed))
      head -n 12 "$dir/$name.log" 2> /dev/null
   fi
done
built=$passed

# --- the same answers there as here. locale/ holds a de_DE made on the spot where the system has only C
mkdir "$dir/locale"
localedef -i de_DE -f UTF-8 "$dir/locale/de_DE.UTF-8" > /dev/null 2>&1
# run NAME COMPILER FLAGS... -- TESTS...: hostile.c compiled so, and these of its tests
run()
{
   local name=run-$1 flags=() ok=0
   shift
   [[ $name == *"$only"* ]] || return
   while [[ $1 != -- ]]; do flags+=("$1") && shift; done
   shift
   if "${flags[@]}" -g -O1 hostile.c -o "$dir/$name" -lm > "$dir/$name.log" 2>&1; then
      ok=1
      for t in "$@"; do
         LOCPATH="$dir/locale" "$dir/$name" "$t" >> "$dir/$name.log" 2>&1 || ok=0
      done
   fi
   if ((ok)); then echo "PASS $name: $(grep -c '^ok' "$dir/$name.log") tests$(grep -q 'decimal comma is set' "$dir/$name.log" && echo ', with a decimal comma')" && ((++passed))
   else
      echo "FAIL $name"
      ((++failed))
      grep -v '^ok' "$dir/$name.log" | head -n 12
   fi
}
machine="t04 t06 t09 t13 t14 t15 t16 t18 t19 t20"
run m32 gcc -m32 -msse2 -- $machine
run x87 gcc -m32 -mno-sse -mfpmath=387 -- $machine
run unsigned-char gcc -funsigned-char -- t02 $machine
run no-simd gcc -DDN_NO_SIMD -- $machine
run native gcc -march=native -O3 -- $machine
run fast-math gcc -ffast-math -- t13 t14 t15 t18
run clang clang -- $machine
run c++ g++ -xc++ -std=c++11 -- t06 t13 t20
echo "builds: $passed passed ($built builds, $((passed - built)) runs), $failed failed, $skipped skipped"
((failed == 0 && (${#names[@]} == 0 || passed >= 1))) && [[ -n $only || $passed -ge 38 ]]
