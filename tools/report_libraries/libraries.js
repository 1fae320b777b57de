// SPDX-License-Identifier: Apache-2.0
// What the pages of reports take from npm; bundle.sh makes one file of it.
export {
  BufferAttribute, BufferGeometry, ConeGeometry, CylinderGeometry, DirectionalLight, GridHelper, Group, HemisphereLight,
  Line, LineBasicMaterial, Mesh, MeshStandardMaterial, PerspectiveCamera, Quaternion, Scene,
  SphereGeometry, Vector3, WebGLRenderer,
} from 'three';
export { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';
export { toCreasedNormals } from 'three/examples/jsm/utils/BufferGeometryUtils.js';
export { default as uPlot } from 'uplot';
