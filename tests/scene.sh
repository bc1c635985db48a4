#!/bin/bash
# scene.sh - the example's glTF reader (C++, tinygltf), by the same program as scene.c, under the sanitizers
# prints  what scene.c prints, and builds; where tinygltf is not installed only that the reader then compiles to nothing
cd "$(dirname "$0")" || exit 2
dir=$(mktemp -d) || exit 2
trap 'rm -rf "$dir"' EXIT
cxx=${CXX:-g++} cc=${CC:-gcc}
W="-Wall -Wextra -Wpedantic -Wshadow -Werror"
SAN="-g -O1 -fsanitize=address,undefined -fno-sanitize-recover=all"
passed=0 failed=0
ok() { if "${@:2}" > "$dir/log" 2>&1; then passed=$((passed + 1)); echo "ok   $1"; else failed=$((failed + 1)); echo "FAIL $1"; head -n 20 "$dir/log"; fi; }
ok "scene_gltf.cc without tinygltf is empty" $cxx -std=c++11 $W -c ../examples/common/scene_gltf.cc -o "$dir/none.o"
ok "headers in C++" $cxx -std=c++11 $W -fsyntax-only -x c++ ../examples/common/scene.h ../examples/common/mesh.h ../examples/common/retarget.h
if ! echo '#include <tiny_gltf.h>' | $cxx -x c++ -E - > /dev/null 2>&1; then
   echo "skip glTF: libtinygltf-dev is not installed"
   echo "scene: $passed passed, $failed failed"
   exit $((failed > 0))
fi
# -isystem is no use here: the header is in /usr/include; its own warnings are not ours to fix, hence no -Wconversion
ok "reader builds" $cxx -std=c++11 -Wall -Wextra -Wshadow $SAN -DEX_TINYGLTF -c ../examples/common/scene_gltf.cc -o "$dir/gltf.o"
ok "program builds" $cc -std=c99 $W $SAN -DEX_TINYGLTF -c scene.c -o "$dir/scene.o"
ok "program links" $cxx $SAN "$dir/scene.o" "$dir/gltf.o" -ltinygltf -lm -o "$dir/scene"
"$dir/scene" "" "$dir" | tee "$dir/out"
[[ $(tail -n 1 "$dir/out") =~ \ ([0-9]+)\ checks,\ ([0-9]+)\ failed ]] && passed=$((passed + BASH_REMATCH[1] - BASH_REMATCH[2])) failed=$((failed + BASH_REMATCH[2])) || failed=$((failed + 1))
echo "scene: $passed passed, $failed failed"
((failed == 0))
