// Makes viewer.js, the script of every page, and three.js.LICENSE: npm ci && npm run build
import { build } from 'esbuild'
import { copyFile, readFile } from 'node:fs/promises'

const { version } = JSON.parse(await readFile('node_modules/three/package.json', 'utf8'))
await build({
  entryPoints: ['src/main.js'],
  outfile: 'viewer.js',
  bundle: true,
  minify: true,
  format: 'iife',
  target: 'es2022',
  charset: 'utf8',
  legalComments: 'none',
  banner: { js: `/*! The page of omnidrones, MIT OR Apache-2.0, with three.js r${version.split('.')[1]}, MIT, (c) 2010-2026 three.js authors: see three.js.LICENSE */` },
})
await copyFile('node_modules/three/LICENSE', 'three.js.LICENSE')
