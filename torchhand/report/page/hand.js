// The hand: bones from joint angles, and the skin that they carry. Matrices are nine numbers by rows.

const BAND_STD = 1.96; // half of the 95 % band of a normal distribution
const RADIANS = Math.PI / 180;

function product(a, b) {
  const c = new Float64Array(9);
  for (let i = 0; i < 3; i++)
    for (let j = 0; j < 3; j++) c[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
  return c;
}

function turned(m, x, y, z) {
  return [m[0] * x + m[1] * y + m[2] * z, m[3] * x + m[4] * y + m[5] * z, m[6] * x + m[7] * y + m[8] * z];
}

function rotationAbout(x, y, z, angle) {
  const c = Math.cos(angle), s = Math.sin(angle), d = 1 - c;
  return [
    c + x * x * d, x * y * d - z * s, x * z * d + y * s,
    y * x * d + z * s, c + y * y * d, y * z * d - x * s,
    z * x * d - y * s, z * y * d + x * s, c + z * z * d,
  ];
}

// x, y, z, w of unit length.
function rotationOfQuaternion(x, y, z, w) {
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
    2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
    2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
  ];
}

class Hand {
  constructor(result) {
    this.result = result;
    const hand = result.hand;
    this.hand = hand;
    this.count = hand.vertices.length / 3;
    this.vertices = new Float32Array(3 * this.count);
    this.normals = new Float32Array(3 * this.count);
    this.faces = Uint16Array.from(hand.faces);
    this.angles = hand.parents.map((_, bone) =>
      hand.bone.map((own, i) => (own === bone ? i : -1)).filter((i) => i >= 0).sort((i, j) => hand.order[i] - hand.order[j]));
    this.places = this._places();
    this.bends = this._bends();
    this.fingers = this._fingers();
    this.rotations = [];
    this.positions = [];
    this.tips = [];
    this.radii = [];
  }

  // Of every vertex, for each of its four bones: the place in the bone's frame times the weight.
  _places() {
    const { vertices, skin_bones, skin_weights, bone_from_hand, bone_origin } = this.hand;
    const places = new Float64Array(12 * this.count);
    for (let v = 0; v < this.count; v++) {
      let total = 0;
      for (let k = 0; k < 4; k++) total += skin_weights[4 * v + k];
      for (let k = 0; k < 4; k++) {
        const bone = skin_bones[4 * v + k], weight = skin_weights[4 * v + k] / total;
        const place = turned(bone_from_hand.slice(9 * bone, 9 * bone + 9), ...vertices.subarray(3 * v, 3 * v + 3));
        for (let i = 0; i < 3; i++) places[12 * v + 3 * k + i] = weight * (place[i] - bone_origin[3 * bone + i]);
        skin_weights[4 * v + k] = weight;
      }
    }
    return places;
  }

  // Of every corrective: the vertices that it moves, and their offsets for sin and 1 - cos.
  _bends() {
    const count = this.hand.corrective_bones.length, all = this.hand.correctives;
    return Array.from({ length: count }, (_, c) => {
      const index = [], offsets = [];
      for (let v = 0; v < this.count; v++) {
        const start = 6 * (v * count + c), own = all.subarray(start, start + 6);
        if (own.some((x) => Math.abs(x) > 1e-5)) { index.push(v); offsets.push(...own); }
      }
      return { index, offsets: Float64Array.from(offsets) };
    });
  }

  // Digit of every vertex, thumb 0 to little 4; 5 for the palm.
  _fingers() {
    const fingers = new Float32Array(this.count), { skin_bones, skin_weights } = this.hand;
    for (let v = 0; v < this.count; v++) {
      const share = [0, 0, 0, 0, 0, 0];
      for (let k = 0; k < 4; k++) share[fingerOfBone(skin_bones[4 * v + k])] += skin_weights[4 * v + k];
      fingers[v] = share.indexOf(Math.max(...share));
    }
    return fingers;
  }

  // Poses the hand as in a row of the result; false where that row has none.
  pose(row) {
    const { result, hand } = this, position = result.position.subarray(3 * row, 3 * row + 3);
    if (row < 0 || Number.isNaN(position[0])) return false;
    const angles = result.angles.subarray(30 * row, 30 * row + 30);
    const turn = result.rotation.subarray(4 * row, 4 * row + 4), length = Math.hypot(...turn);
    this.rotations = [rotationOfQuaternion(...turn.map((x) => x / length))];
    this.positions = [Array.from(position)];
    this.axes = [];
    for (let bone = 1; bone < hand.parents.length; bone++) {
      const parent = hand.parents[bone];
      let local = hand.rest_rotation.slice(9 * bone, 9 * bone + 9);
      for (const i of this.angles[bone]) {
        const axis = hand.axis.slice(3 * i, 3 * i + 3);
        this.axes[i] = turned(this.rotations[parent], ...turned(local, ...axis));
        local = product(local, rotationAbout(...axis, angles[i] * RADIANS));
      }
      const offset = turned(this.rotations[parent], ...hand.rest_offset.slice(3 * bone, 3 * bone + 3));
      this.rotations.push(product(this.rotations[parent], local));
      this.positions.push(offset.map((value, i) => value + this.positions[parent][i]));
    }
    this.tips = LAST_BONES.map((bone, f) =>
      turned(this.rotations[bone], ...hand.tip_offset.slice(3 * f, 3 * f + 3)).map((value, i) => value + this.positions[bone][i]));
    this.radii = LAST_BONES.map((bone, f) => this._radius(row, bone, this.tips[f]));
    this._skin(angles);
    return true;
  }

  // Half of the 95 % band of a fingertip relative to the wrist, in the direction in which it is known least, metres:
  // the joint angles' standard deviations, taken as independent, times their levers.
  _radius(row, last, tip) {
    const { hand, result } = this, cov = new Float64Array(9);
    for (let bone = last; bone > 0; bone = hand.parents[bone])
      for (const i of this.angles[bone]) {
        const std = result.std[30 * row + i] * RADIANS, [ax, ay, az] = this.axes[i];
        const [x, y, z] = tip.map((value, k) => value - this.positions[bone][k]);
        const moved = [std * (ay * z - az * y), std * (az * x - ax * z), std * (ax * y - ay * x)];
        for (let k = 0; k < 9; k++) cov[k] += moved[Math.floor(k / 3)] * moved[k % 3];
      }
    let direction = [1, 0.7, 0.4], variance = 0;
    for (let round = 0; round < 24; round++) { // power iteration
      direction = turned(cov, ...direction);
      variance = Math.hypot(...direction);
      if (!variance) return NaN;
      direction = direction.map((value) => value / variance);
    }
    return BAND_STD * Math.sqrt(variance);
  }

  _skin(angles) {
    const { vertices, places, hand } = this;
    for (let v = 0; v < this.count; v++) {
      let x = 0, y = 0, z = 0;
      for (let k = 0; k < 4; k++) {
        const weight = hand.skin_weights[4 * v + k];
        if (!weight) continue;
        const bone = hand.skin_bones[4 * v + k], m = this.rotations[bone], p = this.positions[bone];
        const a = places[12 * v + 3 * k], b = places[12 * v + 3 * k + 1], c = places[12 * v + 3 * k + 2];
        x += m[0] * a + m[1] * b + m[2] * c + weight * p[0];
        y += m[3] * a + m[4] * b + m[5] * c + weight * p[1];
        z += m[6] * a + m[7] * b + m[8] * c + weight * p[2];
      }
      vertices[3 * v] = x; vertices[3 * v + 1] = y; vertices[3 * v + 2] = z;
    }
    this.bends.forEach(({ index, offsets }, c) => {
      const m = this.rotations[hand.corrective_bones[c]];
      const angle = (angles[hand.corrective_angles[c]] - hand.corrective_zero[c]) * RADIANS;
      const sine = Math.sin(angle) * hand.breadth, cosine = (1 - Math.cos(angle)) * hand.breadth;
      for (let i = 0; i < index.length; i++) {
        const at = 3 * index[i];
        const a = sine * offsets[6 * i] + cosine * offsets[6 * i + 3];
        const b = sine * offsets[6 * i + 1] + cosine * offsets[6 * i + 4];
        const d = sine * offsets[6 * i + 2] + cosine * offsets[6 * i + 5];
        vertices[at] += m[0] * a + m[1] * b + m[2] * d;
        vertices[at + 1] += m[3] * a + m[4] * b + m[5] * d;
        vertices[at + 2] += m[6] * a + m[7] * b + m[8] * d;
      }
    });
    this._shade();
  }

  // Normals: sums of those of the faces around each vertex; the shader makes them unit vectors.
  _shade() {
    const { vertices: p, normals: n, faces } = this;
    n.fill(0);
    for (let f = 0; f < faces.length; f += 3) {
      const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
      const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2];
      const vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
      const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
      for (const at of [a, b, c]) { n[at] += x; n[at + 1] += y; n[at + 2] += z; }
    }
  }
}

const LAST_BONES = [11, 16, 17, 18, 19]; // of thumb to little

// Bones by level, thumb to little in each: the wrist, metacarpals, proximal phalanges, the thumb's distal one, middle
// and distal ones. The metacarpals of the four fingers belong to the palm.
function fingerOfBone(bone) {
  if (bone === 0 || (bone >= 2 && bone <= 5)) return 5;
  if (bone === 1 || bone === 11) return 0;
  return bone <= 10 ? bone - 6 : ((bone - 12) % 4) + 1;
}
