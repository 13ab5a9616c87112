// What viewer.js uses of three.js; README.md beside it says how the bundle is made from this.
import {
  BackSide, BufferAttribute, BufferGeometry, Color, CylinderGeometry, DirectionalLight, DoubleSide,
  Group, HemisphereLight, InstancedMesh, LineBasicMaterial, LineSegments, Matrix4, Mesh,
  MeshLambertMaterial, PerspectiveCamera, Quaternion, RingGeometry, Scene, Spherical, Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

window.PhytacThree = {
  BackSide, BufferAttribute, BufferGeometry, Color, CylinderGeometry, DirectionalLight, DoubleSide,
  Group, HemisphereLight, InstancedMesh, LineBasicMaterial, LineSegments, Matrix4, Mesh,
  MeshLambertMaterial, OrbitControls, PerspectiveCamera, Quaternion, RingGeometry, Scene,
  Spherical, Vector3, WebGLRenderer,
};
