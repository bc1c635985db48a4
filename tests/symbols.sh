#!/bin/sh
# symbols.sh - what the header leaves in an object file, and what each macro of its >>config table changes there
#   no writable data; exports are dn_* and exactly the functions declared; no libc beyond a short list; with the
#   replacements in place none of malloc, assert, stdio and libm; every macro of the table has a check here
# usage   ./symbols.sh [path/to/deformnet.h]         CC chooses the compiler
# prints  a line per check and "symbols: N passed, N failed"; fails as well when it looked at implausibly little
header=${1:-$(dirname "$0")/../deformnet.h}
CC=${CC:-cc}
here=$(cd "$(dirname "$0")" && pwd)
dir=$(mktemp -d) || exit 2
trap 'rm -rf "$dir"' EXIT
cp "$header" "$dir/deformnet.h" || exit 2
cp "$here/test.h" "$here/tiny.h" "$dir/" || exit 2
cd "$dir" || exit 2
passed=0 failed=0
result() # result STATUS NAME: 0 passes
{
   if [ "$1" -eq 0 ]; then passed=$((passed + 1)) && echo "PASS $2"
   else failed=$((failed + 1)) && echo "FAIL $2"; fi
}
# build NAME FLAGS...: NAME.o from a file with only the implementation; not position independent, for then constant
# tables of pointers are constants
printf '#ifdef BEFORE\n#include "before.h"\n#endif\n#define DEFORMNET_IMPLEMENTATION\n#include "deformnet.h"\n' > one.c
build()
{
   name=$1
   shift
   $CC -std=c99 -O2 -fno-pic -fno-pie -c "$@" one.c -o "$name.o" 2> "$name.log" || { head -n 8 "$name.log"; return 1; }
}
defined() { nm --defined-only "$1.o"; }
exported() { nm -g --defined-only "$1.o" | awk '{print $3}' | sort; }
missing() { nm -u "$1.o" | awk '{print $2}' | sort; }

# --- the plain object
build plain; result $? "compiles"
n=$(defined plain | wc -l)
[ "$n" -ge 64 ]; result $? "symbols are seen: $n"
bad=$(defined plain | awk '$2 ~ /^[BbDdCcGgSsVv]$/ {printf " %s", $3}')
[ -z "$bad" ]; result $? "no writable data${bad:+:$bad}"
bytes=$(size -A plain.o | awk '$1 ~ /^\.(data|bss|tbss|tdata)/ {n += $2} END {print n + 0}')
[ "$bytes" -eq 0 ]; result $? "writable sections are empty: $bytes bytes"
bad=$(exported plain | grep -v '^dn_[a-z0-9]' | tr '\n' ' ')
[ -z "$bad" ]; result $? "exports begin with dn_ $bad"
# what is declared: DN_API up to the first ';' or '{', the name before its '('; the header's part only
awk '/^#endif \/\* DEFORMNET_H \*\//{exit} /^ *#/{next} {print}' deformnet.h | sed 's://.*$::' | tr '\n' ' ' | sed 's:/\*[^*]*\*\+\([^/*][^*]*\*\+\)*/: :g' |
   grep -o 'DN_API [^;{]*(' | sed 's/(.*//; s/.*[ *]//' | sort -u > declared.txt
exported plain > exported.txt
n=$(wc -l < declared.txt)
[ "$n" -ge 40 ]; result $? "declarations are seen: $n"
bad=$(comm -3 declared.txt exported.txt | tr -d '\t' | tr '\n' ' ')
[ -z "$bad" ]; result $? "declared and exported agree $bad"

# --- what it takes from outside. memcpy and its kin may also be calls that the compiler made up
allowed="memcpy memmove memset memcmp strlen strcmp strncmp strchr __stack_chk_fail _GLOBAL_OFFSET_TABLE_ __cpu_model __cpu_indicator_init __cpu_features2"
stock="malloc free __assert_fail __assert abort sqrtf fabsf sinf cosf sqrt fabs sincosf __sincosf fopen fclose fread fseek ftell"
foreign() # foreign OBJECT ALLOWED...: undefined symbols that are not allowed
{
   object=$1
   shift
   missing "$object" | while read -r s; do case " $* " in *" $s "*) ;; *) printf '%s ' "$s" ;; esac; done
}
bad=$(foreign plain $allowed $stock)
[ -z "$bad" ]; result $? "takes from libc only what it says $bad"
cat > before.h <<'E'
#include <stddef.h>
void *my_malloc(size_t size);
void my_free(void *ptr);
void my_assert(int ok);
float my_sqrtf(float), my_fabsf(float), my_sinf(float), my_cosf(float);
double my_sqrt(double), my_fabs(double);
#define DN_MALLOC(size) my_malloc(size)
#define DN_FREE(ptr) my_free(ptr)
#define DN_ASSERT(x) my_assert(!!(x))
#define DN_SQRTF(x) my_sqrtf(x)
#define DN_FABSF(x) my_fabsf(x)
#define DN_SINF(x) my_sinf(x)
#define DN_COSF(x) my_cosf(x)
#define DN_SQRT(x) my_sqrt(x)
#define DN_FABS(x) my_fabs(x)
E
build free -DBEFORE -DDN_NO_STDIO; result $? "compiles with everything replaced"
mine="my_malloc my_free my_assert my_sqrtf my_fabsf my_sinf my_cosf my_sqrt my_fabs"
bad=$(foreign free $allowed $mine)
[ -z "$bad" ]; result $? "with everything replaced, nothing of libc but memory and strings $bad"
unset bad
for s in $mine; do
   m=DN_$(echo "${s#my_}" | tr a-z A-Z)
   if ! grep -v '^ *#' deformnet.h | grep -q "\b$m("; then echo "NOTE no code uses $m"; continue; fi
   missing free | grep -qx "$s" || bad="$bad $s"
done
[ -z "$bad" ]; result $? "every replacement is used$bad"
grep -q '#include <\(stdio\|stdlib\|math\|assert\)' deformnet.h; result $? "the headers that can go are there to begin with"
$CC -std=c99 -DBEFORE -DDN_NO_STDIO -M one.c > deps.txt 2> /dev/null
bad=$(tr ' \\' '\n\n' < deps.txt | grep -E '/(stdio|stdlib|math|assert|locale|ctype|time)\.h$' | grep -v '/bits/' | tr '\n' ' ')
if grep -q '__x86_64__\|immintrin' deformnet.h; then bad=$(echo "$bad" | tr ' ' '\n' | grep -v '/stdlib\.h$' | tr -d '\n'); fi # gcc's immintrin.h takes stdlib.h along
[ -z "$bad" ]; result $? "with everything replaced, includes none of their headers $bad"

# --- the >>config table, row by row
awk '/>>config$/{on = 1} on {print} on && /\*\//{exit}' deformnet.h | grep -oE '\b(DN|DEFORMNET)_[A-Z0-9_]+' | sort -u | grep -v '^DN_ERROR$' > macros.txt
n=$(wc -l < macros.txt)
[ "$n" -ge 14 ]; result $? "macros in the table: $n"
for m in $(cat macros.txt); do
   case $m in
   DEFORMNET_STATIC)
      build static -DDEFORMNET_STATIC -Wall -Wextra -Werror
      result $? "$m: compiles without a warning"
      n=$(exported static | wc -l)
      [ "$n" -eq 0 ]; result $? "$m: exports nothing ($n)"
      ;;
   DN_API)
      build api '-DDN_API=__attribute__((visibility("hidden"))) extern'
      n=$(readelf -sW api.o | awk '$6 == "HIDDEN" && $8 ~ /^dn_/' | wc -l)
      [ "$n" -eq "$(wc -l < declared.txt)" ]; result $? "$m: sets the linkage of all $n functions"
      ;;
   DN_ASSERT) ! missing free | grep -q assert_fail && missing plain | grep -q assert; result $? "$m: replaces assert" ;;
   DN_MALLOC | DN_FREE)
      ! build half "-D$m(x)=0" > /dev/null 2>&1; result $? "$m: alone is an error"
      ! missing free | grep -qx 'malloc\|free' && missing plain | grep -qx malloc; result $? "$m: replaces malloc and free"
      ;;
   DN_SQRTF | DN_FABSF | DN_SINF | DN_COSF | DN_SQRT | DN_FABS)
      ! build half "-D$m(x)=(x)" > /dev/null 2>&1; result $? "$m: alone is an error"
      ;;
   DN_NO_STDIO)
      build nostdio -DDN_NO_STDIO
      ! missing nostdio | grep -q 'fopen\|fread' && missing plain | grep -q fopen; result $? "$m: opens no files"
      ! exported nostdio | grep -q dn_model_load_file && exported plain | grep -q dn_model_load_file; result $? "$m: no dn_model_load_file"
      ;;
   DN_NO_SIMD)
      build scalar -DDN_NO_SIMD
      case $($CC -dumpmachine) in
      x86_64* | i?86*)
         wide=$(objdump -d plain.o | grep -c '%[yz]mm') none=$(objdump -d scalar.o | grep -c '%[yz]mm')
         [ "$none" -eq 0 ] && [ "$wide" -ge 100 ]; result $? "$m: no wide vectors ($none instructions, $wide without it)"
         ;;
      *) [ "$(size scalar.o | awk 'NR == 2 {print $1}')" -lt "$(size plain.o | awk 'NR == 2 {print $1}')" ]; result $? "$m: leaves kernels out" ;;
      esac
      ;;
   DN_EXACT) # that its bits are the same everywhere, and what it refuses: exact.sh
      build exact -DDN_EXACT -Wall -Wextra -Werror; result $? "$m: compiles without a warning"
      ! missing exact | grep -q 'sinf\|cosf' && missing plain | grep -q sinf; result $? "$m: asks no libm for a sine"
      defined exact | awk '{print $3}' | sort > of_exact.txt
      build scalar -DDN_NO_SIMD
      defined scalar | awk '{print $3}' | sort > of_scalar.txt
      bad=$(comm -13 of_scalar.txt of_exact.txt | grep ^dn | grep -v '^dn__sine' | sed 's/\..*//' | sort -u | tr '\n' ' ')
      [ -s of_scalar.txt ] && [ -z "$bad" ]; result $? "$m: has no function that DN_NO_SIMD has not $bad"
      ;;
   DN_MAX_DIM)
      cat > dim.c <<'E'
#define DEFORMNET_IMPLEMENTATION
#include "deformnet.h"
#include "test.h"
#include "tiny.h"
int main(void)
{
   size_t size;
   unsigned char *file = tiny_mlp(&size); /* its widest side is 6 */
   dn_error e;
   dn_model *m = dn_model_load(file, size, NULL, NULL, &e);
   int refused = !m && e.code == DN_BAD_SHAPE;
   dn_model_free(m);
   free(file);
   return m ? 10 : refused ? 20 : 1;
}
E
      for d in 5 6; do
         $CC -std=c99 -DDN_MAX_DIM=$d dim.c -o dim -lm 2> /dev/null; ./dim 2> /dev/null
         [ $? -eq $((d == 5 ? 20 : 10)) ]; result $? "$m: $d $([ $d = 5 ] && echo refuses || echo takes) a model with a side of 6"
      done
      ;;
   *) result 1 "$m is in the table but has no check in symbols.sh" ;;
   esac
done
# and the other way round: what the code lets a user set is in the table
for m in $(grep -oE '^ *#ifndef (DN|DEFORMNET)_[A-Z0-9_]+' deformnet.h | awk '{print $2}' | sort -u) \
   $(grep -oE 'defined\((DN|DEFORMNET)_[A-Z0-9_]+\)' deformnet.h | sed 's/.*(//; s/)//' | sort -u); do
   case $m in DEFORMNET_H | DEFORMNET_IMPLEMENTATION | DN__*) continue ;; esac
   grep -qx "$m" macros.txt || { result 1 "$m can be set, but is not in the table"; }
done
# no macro changes the layout of a public struct
cat > layout.c <<'E'
#include "deformnet.h"
#include <stdio.h>
E
structs=$(awk '/^#endif \/\* DEFORMNET_H \*\//{exit} {print}' deformnet.h | grep -oE '^typedef struct dn_[a-z_]+ \{' | awk '{print $3}' | sort -u)
{
   echo 'int main(void) {'
   for s in $structs; do printf '   printf("%s %%lu\\n", (unsigned long)sizeof(%s));\n' "$s" "$s"; done
   echo '   return 0; }'
} >> layout.c
$CC -std=c99 layout.c -o layout 2> /dev/null && ./layout > layout.txt
$CC -std=c99 -include before.h -DDN_NO_STDIO -DDN_NO_SIMD -DDN_EXACT -DDN_MAX_DIM=7 -DDEFORMNET_STATIC -w layout.c -o layout 2> /dev/null && ./layout > layout2.txt
n=$(cat layout.txt | wc -l)
[ "$n" -ge 15 ] && cmp -s layout.txt layout2.txt; result $? "the macros leave the sizes of $n structs alone"

# --- the stack: no function takes much, none an amount that depends on its input
if $CC -fstack-usage -std=c99 -O2 -c one.c -o stack.o 2> /dev/null && [ -s stack.su ]; then
   n=$(wc -l < stack.su)
   most=$(awk -F'\t' '$2 > m {m = $2; f = $1} END {sub(/.*:/, "", f); print m, f}' stack.su)
   [ "$n" -ge 64 ] && [ "${most%% *}" -le 16384 ]; result $? "stack: at most $most, of $n functions"
   bad=$(awk -F'\t' '$3 ~ /dynamic/ && $3 !~ /bounded/ {sub(/.*:/, "", $1); printf "%s ", $1}' stack.su)
   [ -z "$bad" ]; result $? "stack: no size depends on input $bad"
fi
echo "symbols: $passed passed, $failed failed"
[ "$failed" -eq 0 ] && [ "$passed" -ge 35 ]
