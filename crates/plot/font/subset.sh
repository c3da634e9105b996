#!/bin/sh
# Makes roboto-subset.ttf: Latin, Greek and maths signs of Roboto Regular (Apache-2.0), no hinting, no layout tables but kerning.
# Needs Debian's fonts-roboto-unhinted and Python's fonttools.
set -eu
cd "$(dirname "$0")"
pyftsubset "${1:-/usr/share/fonts/truetype/roboto/unhinted/RobotoTTF/Roboto-Regular.ttf}" \
  --output-file=roboto-subset.ttf --no-hinting --desubroutinize --legacy-kern --layout-features=kern \
  --unicodes="U+0020-007E,U+00A0-017F,U+0391-03A9,U+03B1-03C9,U+0307,U+2010-2016,U+2018-201E,U+2020-2022,U+2026,U+2030,U+2032,U+2033,U+2070-208E,U+20AC,U+2126,U+2190-2193,U+2202,U+2206,U+220F,U+2211,U+2212,U+221A,U+221E,U+222B,U+2248,U+2260,U+2264,U+2265,U+25CA"
