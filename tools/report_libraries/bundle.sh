#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# npm packages → libraries.js, uPlot.css and LICENSES of the report's page. Needs node and npm, and is run by hand
# when package.json changes; what it makes is committed, so nobody else needs either.
#   bundle.sh [FOLDER]    default: the page of microhand_station; another one to compare with
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
page=${1:-$here/../../ros_ws/src/microhand_station/microhand_station/analysis/page}
mkdir -p "$page"
page=$(cd "$page" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cp "$here"/package.json "$here"/package-lock.json "$here"/libraries.js "$work"
cd "$work"
npm ci --ignore-scripts --no-audit --no-fund --loglevel=error
versions=$(node -p 'const {dependencies: d} = require("./package.json"); Object.entries(d).map(([n, v]) => `${n} ${v}`).join(", ")')
# not `npx esbuild`: its own start script is fetched by an install script, which is not run
node_modules/@esbuild/linux-x64/bin/esbuild libraries.js --bundle --minify --format=iife --global-name=libraries \
  --target=es2020 --legal-comments=none --log-level=warning --banner:js="/* $versions; MIT, see LICENSES */" --outfile="$page/libraries.js"
cp node_modules/uplot/dist/uPlot.min.css "$page/uPlot.css"
for name in three uplot; do
  printf '%s %s\n\n' "$name" "$(node -p "require('./node_modules/$name/package.json').version")"
  cat "node_modules/$name/LICENSE"
  printf '\n\n'
done >"$page/LICENSES"
ls -l "$page"
