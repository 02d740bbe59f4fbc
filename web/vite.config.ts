import { defineConfig } from "vite";

// One script and one style sheet with fixed names: the server lists them, and a change of the code is a change of two files.
export default defineConfig({
  base: "./",
  build: {
    outDir: "../src/farfield/studio/static",
    emptyOutDir: true,
    target: "es2022",
    modulePreload: false,
    assetsInlineLimit: 0,
    sourcemap: false,
    chunkSizeWarningLimit: 1000,
    rolldownOptions: {
      output: { entryFileNames: "studio.js", chunkFileNames: "[name].js", assetFileNames: "studio[extname]" },
    },
  },
});
