// Builds three.min.js beside this file: the part of three.js that viewer.js uses, as one script that sets the global
// THREE. In an empty folder:
//   npm install three@0.187.0 esbuild && cp .../template/three.build.mjs . && node three.build.mjs
// Shaders that the viewer does not use are left blank; they are a quarter of the library.
import { build } from "esbuild";
import { readFile } from "node:fs/promises";

const THREE = "node_modules/three/";
const PARTS = `
  export {
    BufferAttribute, BufferGeometry, CanvasTexture, Color, ColorManagement, DoubleSide, DynamicDrawUsage, Group,
    LinearSRGBColorSpace, Mesh, OrthographicCamera, Points, Raycaster, Scene, ShaderMaterial, Sprite, SpriteMaterial,
    Vector2, Vector3, WebGLRenderer,
  } from "three";
  export { OrbitControls } from "three/addons/controls/OrbitControls.js";
  export { LineMaterial } from "three/addons/lines/LineMaterial.js";
  export { LineSegments2 } from "three/addons/lines/LineSegments2.js";
  export { LineSegmentsGeometry } from "three/addons/lines/LineSegmentsGeometry.js";`;
const SHADER = /^(?:var|const) (\w+|(?:vertex|fragment)\$\w+) = "(.*)";$/gm;
const ALWAYS = ["tonemapping_pars_fragment", "colorspace_pars_fragment"];  // WebGLProgram puts them into every shader

// The shaders that sprites and wide lines include, directly or not.
async function used(library) {
  const shaders = new Map([...library.matchAll(SHADER)].map(([, name, text]) => [name, text]));
  const entry = (name) => library.match(new RegExp(`\\b${name}: (\\S+?),?\\n`))[1];
  const lines = await readFile(`${THREE}examples/jsm/lines/LineMaterial.js`, "utf8");
  const included = (text) => [...text.matchAll(/#include <(\w+)>/g)].map(([, name]) => name);
  const open = [...ALWAYS, entry("sprite_vert"), entry("sprite_frag"), ...included(lines)], names = new Set();
  while (open.length) {
    const name = open.pop();
    if (!names.has(name)) open.push(...included(shaders.get(name)));
    names.add(name);
  }
  return names;
}

const library = await readFile(`${THREE}build/three.module.js`, "utf8");
const names = await used(library);
const lean = library
  .replace(SHADER, (all, name, text) => {
    const isShader = /[;}]|#include/.test(text) && text.includes("\\n");
    return isShader && !names.has(name) ? all.replace(text, () => "") : all;
  })
  .replace(/\\n(\\t)+/g, "\\n");
const licence = (await readFile(`${THREE}LICENSE`, "utf8")).trim();
const { version } = JSON.parse(await readFile(`${THREE}package.json`, "utf8"));
await build({
  stdin: { contents: PARTS, resolveDir: "." }, outfile: "three.min.js", format: "iife", globalName: "THREE",
  bundle: true, minify: true, charset: "utf8", target: "es2020", legalComments: "none",
  banner: { js: `/*! three.js ${version}\n\n${licence}\n*/` },
  plugins: [{
    name: "lean",
    setup: (building) => building.onLoad({ filter: /\.js$/ }, async ({ path }) => ({
      loader: "js",
      // Tabs at the beginning of a line matter neither in JavaScript nor in shaders.
      contents: (path.endsWith("three.module.js") ? lean : await readFile(path, "utf8")).replace(/^\t+/gm, ""),
    })),
  }],
});
