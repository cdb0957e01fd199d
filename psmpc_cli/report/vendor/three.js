// What the viewer uses of three.js 0.187.0. three.min.js is made of it, beside an installed three, by
// esbuild three.js --bundle --minify --format=iife --global-name=THREE --legal-comments=none --target=es2020
export { BoxGeometry, BufferAttribute, BufferGeometry, CapsuleGeometry, DirectionalLight, EdgesGeometry, Group, HemisphereLight, LineBasicMaterial, LineSegments, Mesh, MeshLambertMaterial, PerspectiveCamera, Quaternion, Scene, SphereGeometry, Vector3, WebGLRenderer } from "three";
export { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
export { Line2 } from "three/examples/jsm/lines/Line2.js";
export { LineGeometry } from "three/examples/jsm/lines/LineGeometry.js";
export { LineMaterial } from "three/examples/jsm/lines/LineMaterial.js";
