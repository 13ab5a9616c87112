// The turnable shell: PhytacViewer.create(element, data) -> viewer, or null without WebGL.
(function () {
  "use strict";
  const C = window.PhytacColours, T = window.PhytacThree;
  const STEP = 0.12, ZOOM = 1.15, NEAR_PX = 14, CLEAR = 0.2, SIDES = 14;

  const able = () => {
    try {
      return Boolean(document.createElement("canvas").getContext("webgl2"));
    } catch {
      return false;
    }
  };

  function create(element, first) {
    if (!T || !able()) return null;
    const renderer = new T.WebGLRenderer({ antialias: true, alpha: true });
    const canvas = renderer.domElement, scene = new T.Scene();
    const camera = new T.PerspectiveCamera(28, 1, 1, 1000);
    const sun = new T.DirectionalLight(0xffffff, 1.2);
    let data = null, model = null, colouring = null, marker = -1, waiting = 0;
    let tips = null, painted = [], parts = [], size = 1, mode = null;
    const middle = new T.Vector3(), self = { onSelect: null, onTurn: null };

    camera.up.set(0, 0, 1);
    scene.add(new T.HemisphereLight(0xffffff, 0xd8d4cc, 2.1), camera);
    camera.add(sun);
    sun.position.set(-0.4, 0.6, 1);
    element.append(canvas);
    element.classList.add("live");
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "application");
    canvas.setAttribute("aria-label", "The shell in three dimensions. Arrow "
      + "keys turn it, plus and minus zoom, Home turns it back.");
    const controls = new T.OrbitControls(camera, canvas);
    controls.enablePan = false;
    controls.enableZoom = false;
    controls.addEventListener("change", () => {
      draw();
      if (self.onTurn && data) self.onTurn(self.view());
    });
    // One finger across turns, up and down scrolls the page; the wheel zooms once it is clicked.
    canvas.style.touchAction = "pan-y";
    canvas.addEventListener("focus", () => { controls.enableZoom = true; });
    canvas.addEventListener("blur", () => { controls.enableZoom = false; });

    function draw() {
      if (waiting) return;
      waiting = requestAnimationFrame(() => {
        waiting = 0;
        cut();
        renderer.render(scene, camera);
        element.dataset.drawn = String(1 + Number(element.dataset.drawn || 0));
      });
    }

    function resize() {
      const wide = element.clientWidth, high = Math.max(240, Math.min(0.8 * wide, 520));
      if (!wide) return;
      renderer.setPixelRatio(Math.min(2, window.devicePixelRatio || 1));
      renderer.setSize(wide, high);
      camera.aspect = wide / high;
      camera.updateProjectionMatrix();
      draw();
    }

    function meshOf(body, box) {
      const geometry = new T.BufferGeometry();
      geometry.setAttribute("position", new T.BufferAttribute(C.places(box, body.points), 3));
      geometry.setIndex(new T.BufferAttribute(new Uint32Array(C.bytes(body.triangles)), 1));
      geometry.computeVertexNormals();
      const look = { color: body.colour, side: T.DoubleSide };
      const mesh = new T.Mesh(geometry, new T.MeshLambertMaterial(look));
      mesh.name = body.name;
      return mesh;
    }

    // Instances of a shape on every tube, from share a to share b of its length, mm from the tip.
    function along(geometry, colour, foot, axis, length, from, to, radius) {
      const many = new T.InstancedMesh(geometry,
        new T.MeshLambertMaterial({ color: colour, side: T.DoubleSide }), length.length);
      const turn = new T.Quaternion(), up = new T.Vector3(0, 1, 0), at = new T.Vector3();
      const place = new T.Matrix4(), sizes = new T.Vector3(), way = new T.Vector3();
      for (let i = 0; i < length.length; i++) {
        way.fromArray(axis, 3 * i);
        const a = from(length[i]), b = to(length[i]);
        turn.setFromUnitVectors(up, way);
        at.fromArray(foot, 3 * i).addScaledVector(way, a);
        place.compose(at, turn, sizes.set(radius, Math.max(b - a, 1e-4), radius));
        many.setMatrixAt(i, place);
      }
      many.userData.whole = many.instanceMatrix.array.slice();
      model.add(many);
      parts.push(many);
      return many;
    }

    // Cut open: receptors that turn their back on the viewer are left out.
    function cut() {
      if (!model) return;
      const { axis, shown } = model.userData, eye = camera.position;
      let changed = false;
      for (let i = 0; i < shown.length; i++) {
        const j = 3 * i;
        const facing = axis[j] * (eye.x - tips[j]) + axis[j + 1] * (eye.y - tips[j + 1])
          + axis[j + 2] * (eye.z - tips[j + 2]);
        const seen = mode !== "cut" || facing > 0 ? 1 : 0;
        if (seen === shown[i]) continue;
        shown[i] = seen;
        changed = true;
        for (const part of parts) {
          const at = part.instanceMatrix.array, whole = part.userData.whole;
          for (let k = 16 * i; k < 16 * i + 16; k++) at[k] = seen ? whole[k] : 0;
        }
      }
      if (changed) for (const part of parts) part.instanceMatrix.needsUpdate = true;
    }

    function tubes() {
      const { tubes: t, box } = data, foot = C.places(box, t.foot);
      tips = C.places(box, t.tip);
      const n = tips.length / 3, axis = new Float32Array(3 * n), length = new Float32Array(n);
      for (let i = 0; i < n; i++) {
        const d = [0, 1, 2].map(k => tips[3 * i + k] - foot[3 * i + k]);
        length[i] = Math.hypot(...d) || 1e-6;
        d.forEach((value, k) => { axis[3 * i + k] = value / length[i]; });
      }
      const rod = new T.CylinderGeometry(1, 1, 1, SIDES, 1, true);
      rod.translate(0, 0.5, 0);
      const flat = (inner, outer) => {
        const ring = new T.RingGeometry(inner, outer, SIDES, 1);
        ring.rotateX(-Math.PI / 2);
        return ring;
      };
      const band = l => Math.max(l - t.band_mm, 0), hole = Math.min(t.hole_mm / t.radius_mm, 0.98);
      const put = (shape, colour, from, to, radius = t.radius_mm) =>
        along(shape, colour, foot, axis, length, from, to, radius);
      put(rod, "#c9c4bb", () => 0, band, t.tube_mm);
      put(flat(0, hole), "#3a3a3a", l => l - 0.02, l => l);
      painted = [put(rod, "#ffffff", band, l => l), put(flat(hole, 1), "#ffffff", l => l, l => l)];
      const ring = new T.CylinderGeometry(1.5 * t.radius_mm, 1.5 * t.radius_mm, 1.2 * t.radius_mm, 24);
      const chosen = new T.Mesh(ring,
        new T.MeshLambertMaterial({ color: "#ff6a00", transparent: true, opacity: 0.7,
          depthTest: false }));
      chosen.visible = false;
      chosen.renderOrder = 3;
      model.add(chosen);
      model.userData = { chosen, axis, shown: new Uint8Array(n).fill(1) };
    }

    function free(group) {
      group.traverse(item => {
        if (item.geometry) item.geometry.dispose();
        if (item.material) item.material.dispose();
        if (item.isInstancedMesh) item.dispose();
      });
      scene.remove(group);
    }

    self.update = next => {
      const start = data === null;
      data = next;
      if (model) free(model);
      model = new T.Group();
      parts = [];
      scene.add(model);
      for (const body of data.bodies) model.add(meshOf(body, data.box));
      tubes();
      const lines = C.places(data.box, data.lines);
      if (lines.length) {
        const geometry = new T.BufferGeometry();
        geometry.setAttribute("position", new T.BufferAttribute(lines, 3));
        model.add(new T.LineSegments(geometry, new T.LineBasicMaterial({ color: "#666666" })));
      }
      // Fit to the wall: cameras that stand far off need not be in view.
      const wall = C.places(data.box, data.bodies[0].points);
      const low = [Infinity, Infinity, Infinity], high = low.map(v => -v);
      wall.forEach((value, i) => {
        low[i % 3] = Math.min(low[i % 3], value);
        high[i % 3] = Math.max(high[i % 3], value);
      });
      const before = size, centre = low.map((v, k) => (v + high[k]) / 2);
      size = Math.hypot(...low.map((v, k) => high[k] - v));
      const away = camera.position.clone().sub(middle).multiplyScalar(size / before);
      middle.fromArray(centre);
      camera.near = size / 100;
      camera.far = size * 20;
      camera.updateProjectionMatrix();
      controls.minDistance = 0.2 * size;
      controls.maxDistance = 8 * size;
      if (start) self.reset();
      else {
        camera.position.copy(middle).add(away);
        controls.target.copy(middle);
        controls.update();
      }
      self.wall(mode || data.wall);
      self.colourBy(colouring ? colouring.key : data.colourings[0].key);
      self.select(marker < tips.length / 3 ? marker : -1);
    };

    self.reset = () => {
      const back = size / (2 * Math.tan(camera.fov * Math.PI / 360));
      camera.position.fromArray(data.eye).multiplyScalar(back).add(middle);
      controls.target.copy(middle);
      controls.update();
      draw();
    };

    self.colourBy = key => {
      colouring = C.find(data, key);
      const colour = new T.Color();
      C.of(data, colouring).forEach((rgb, i) => {
        colour.setRGB(rgb[0] / 255, rgb[1] / 255, rgb[2] / 255, "srgb");
        for (const part of painted) part.setColorAt(i, colour);
      });
      for (const part of painted) part.instanceColor.needsUpdate = true;
      draw();
    };

    self.turn = (around, up) => {
      const turned = new T.Spherical(), up_ = camera.position.clone().sub(middle);
      const level = new T.Quaternion().setFromUnitVectors(camera.up, new T.Vector3(0, 1, 0));
      turned.setFromVector3(up_.applyQuaternion(level));
      turned.theta += around;
      turned.phi = Math.min(Math.PI - 0.01, Math.max(0.01, turned.phi - up));
      camera.position.setFromSpherical(turned).applyQuaternion(level.invert()).add(middle);
      controls.update();
      draw();
    };

    // Where the viewer stands, in units of the sensor's size: for look() of another one.
    self.view = () => camera.position.clone().sub(middle).divideScalar(size).toArray();
    self.look = view => {
      const listener = self.onTurn;
      self.onTurn = null;
      camera.position.fromArray(view).multiplyScalar(size).add(middle);
      controls.update();
      self.onTurn = listener;
      draw();
    };

    self.zoom = factor => {
      const away = camera.position.clone().sub(middle).divideScalar(factor);
      away.clampLength(controls.minDistance, controls.maxDistance);
      camera.position.copy(middle).add(away);
      controls.update();
      draw();
    };

    // How the wall is shown: "cut" open, "clear" (seen through) or "none".
    self.wall = chosen => {
      mode = chosen;
      const wall = model.children.find(item => item.name === "wall"), clear = mode === "clear";
      wall.visible = mode !== "none";
      wall.renderOrder = clear ? 2 : 0;
      Object.assign(wall.material, { transparent: clear, opacity: clear ? CLEAR : 1,
        depthWrite: !clear, side: clear ? T.DoubleSide : T.BackSide, needsUpdate: true });
      draw();
    };

    self.select = chosen => {
      marker = chosen;
      const ring = model.userData.chosen, axis = model.userData.axis;
      ring.visible = marker >= 0;
      if (marker >= 0) {
        ring.position.fromArray(tips, 3 * marker);
        ring.quaternion.setFromUnitVectors(
          new T.Vector3(0, 1, 0), new T.Vector3().fromArray(axis, 3 * marker));
      }
      draw();
    };

    // Marker whose tip is drawn under a place of the canvas: of those near it the foremost.
    function under(event) {
      const box = canvas.getBoundingClientRect(), point = new T.Vector3();
      let best = -1, depth = Infinity;
      for (let i = 0; i < tips.length / 3; i++) {
        if (!model.userData.shown[i]) continue;
        point.fromArray(tips, 3 * i).project(camera);
        const x = (point.x + 1) / 2 * box.width, y = (1 - point.y) / 2 * box.height;
        const off = Math.hypot(x - (event.clientX - box.left), y - (event.clientY - box.top));
        if (off < NEAR_PX && point.z < depth) [best, depth] = [i, point.z];
      }
      return best;
    }
    canvas.addEventListener("pointermove", event => {
      if (event.buttons) return;
      const found = under(event);
      if (found < 0 || found === marker) return;
      self.select(found);
      if (self.onSelect) self.onSelect(found);
    });
    canvas.addEventListener("keydown", event => {
      const act = {
        ArrowLeft: () => self.turn(-STEP, 0), ArrowRight: () => self.turn(STEP, 0),
        ArrowUp: () => self.turn(0, STEP), ArrowDown: () => self.turn(0, -STEP),
        "+": () => self.zoom(ZOOM), "=": () => self.zoom(ZOOM), "-": () => self.zoom(1 / ZOOM),
        Home: self.reset,
      }[event.key];
      if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      act();
    });
    canvas.addEventListener("webglcontextlost", event => {
      event.preventDefault();
      element.classList.remove("live");
    });
    canvas.addEventListener("webglcontextrestored", () => {
      element.classList.add("live");
      draw();
    });

    self.picture = () => {
      cut();
      renderer.render(scene, camera);
      return canvas.toDataURL("image/png");
    };
    const watch = new ResizeObserver(resize);
    watch.observe(element);
    self.dispose = () => {
      watch.disconnect();
      cancelAnimationFrame(waiting);
      controls.dispose();
      if (model) free(model);
      renderer.dispose();
      canvas.remove();
      element.classList.remove("live");
    };
    self.canvas = canvas;
    self.update(first);
    resize();
    return self;
  }

  window.PhytacViewer = { create };
})();
