// Build the part of plotly.js that compplan's pages draw with; see README.md beside it.
const { environmentPlugin } = require('esbuild-plugin-environment');
const { glsl } = require('esbuild-plugin-glsl');
const css = require('esbuild-plugin-inline-css');
const traces = ['scatter', 'bar', 'box', 'heatmap', 'scatter3d', 'mesh3d'];
const version = require('plotly.js/package.json').version;
const register = traces.map((name) => `require('plotly.js/lib/${name}')`).join(', ');
require('esbuild').build({
  stdin: {
    contents: `module.exports = require('plotly.js/lib/core'); module.exports.register([${register}]);`,
    resolveDir: process.cwd(),
  },
  banner: { js: `/* plotly.js v${version} (${traces.join(', ')}), Copyright 2012-2026 Plotly, Inc., MIT licence */` },
  format: 'iife', globalName: 'Plotly', bundle: true, minify: true, target: 'es2016', legalComments: 'none',
  plugins: [css(), glsl({ minify: true }), environmentPlugin({ NODE_DEBUG: false })],
  alias: { regl: '@plotly/regl', stream: 'stream-browserify' },
  define: { global: 'window', 'define.amd': 'false' },
  outfile: 'plotly.min.js',
});
