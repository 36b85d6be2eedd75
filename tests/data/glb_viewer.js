// Runs in a page behind three.js: shows a GLB from the south-east, and tells what it found.
let report;
window.found = new Promise((done) => { report = done; });
window.onerror = (message) => report({ error: String(message) });
try {
  const bytes = Uint8Array.from(atob("$GLB"), (letter) => letter.charCodeAt(0));
  const renderer = new THREE.WebGLRenderer({ antialias: true });
  renderer.setSize(900, 600);
  document.body.replaceChildren(renderer.domElement);
  const scene = new THREE.Scene();
  scene.background = new THREE.Color(0xffffff);
  new THREE.GLTFLoader().parse(bytes.buffer, "", (gltf) => {
    scene.add(gltf.scene);
    const box = new THREE.Box3().setFromObject(gltf.scene);
    const sphere = box.getBoundingSphere(new THREE.Sphere());
    const camera = new THREE.PerspectiveCamera(35, 1.5, sphere.radius / 100, sphere.radius * 10);
    const away = new THREE.Vector3(0.6, 0.9, 1.2).normalize().multiplyScalar(2.5 * sphere.radius);
    camera.position.copy(sphere.center).add(away);
    camera.lookAt(sphere.center);
    const sun = new THREE.DirectionalLight(0xffffff, 1);
    sun.position.set(-1, 1.2, -0.6);
    scene.add(sun, new THREE.AmbientLight(0xffffff, 0.6));
    renderer.outputEncoding = THREE.sRGBEncoding;
    renderer.render(scene, camera);
    const meshes = [];
    gltf.scene.traverse((each) => each.isMesh && meshes.push(each));
    const { index, attributes } = meshes[0].geometry;
    report({
      meshes: meshes.length,
      vertices: attributes.position.count,
      triangles: index.count / 3,
      attributes: Object.keys(attributes).sort(),
      box: [box.min.toArray(), box.max.toArray()],
      colour: attributes.color && Array.from(attributes.color.array.slice(0, 4)),
      extras: meshes[0].userData,
      drawn: renderer.info.render.triangles,
    });
  }, (error) => report({ error: String(error) }));
} catch (error) {
  report({ error: String(error) });
}
