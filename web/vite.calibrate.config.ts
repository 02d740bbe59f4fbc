import { defineConfig } from "vite";

// The calibration page: a script and a style sheet of its own beside the studio's, without what only the studio draws with.
export default defineConfig({
  base: "./",
  build: {
    outDir: "../src/farfield/studio/static",
    emptyOutDir: false,
    target: "es2022",
    modulePreload: false,
    assetsInlineLimit: 0,
    sourcemap: false,
    rolldownOptions: {
      input: "calibrate.html",
      output: { entryFileNames: "calibrate.js", chunkFileNames: "[name].js", assetFileNames: "calibrate[extname]" },
    },
  },
});
