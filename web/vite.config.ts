import { svelte } from '@sveltejs/vite-plugin-svelte';
import { defineConfig } from 'vite';

// Fixed names, relative addresses, nothing within the HTML: the built page is part of the program
// (client/src/commands/web), works behind proxies, and its policy forbids inline scripts and styles.
export default defineConfig({
  plugins: [svelte({ compilerOptions: { css: 'external' } })],
  base: './',
  publicDir: 'public',
  build: {
    outDir: 'built',
    emptyOutDir: true,
    target: 'es2022',
    assetsInlineLimit: 0,
    cssCodeSplit: false,
    modulePreload: { polyfill: false },
    rolldownOptions: {
      output: { entryFileNames: 'page.js', assetFileNames: 'page[extname]' },
    },
  },
});
