// What `cargo xtask vendor` takes of three.js: the bundle `three.js` beside this file offers exactly these names as `THREE`.
export {
  AmbientLight, ArrowHelper, BackSide, Box3, BoxGeometry, BufferAttribute, BufferGeometry, CanvasTexture, CapsuleGeometry, Color,
  ConeGeometry, CylinderGeometry, DirectionalLight, DoubleSide, EdgesGeometry, Euler, Float32BufferAttribute, FrontSide, GridHelper,
  Group, HemisphereLight, InstancedMesh, Line, LineBasicMaterial, LineDashedMaterial, LineSegments, Matrix4, Mesh, MeshBasicMaterial,
  MeshLambertMaterial, Object3D, PerspectiveCamera, PlaneGeometry, Points, PointsMaterial, Quaternion, Raycaster, RepeatWrapping,
  RingGeometry, SRGBColorSpace, Scene, Sphere, SphereGeometry, TorusGeometry, Vector2, Vector3, WebGLRenderer, WireframeGeometry,
} from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";
export { Line2 } from "three/addons/lines/Line2.js";
export { LineGeometry } from "three/addons/lines/LineGeometry.js";
export { LineMaterial } from "three/addons/lines/LineMaterial.js";
