// Arrays as torchhand/report/packing.py writes them: base64 of deflated differences along the first axis.

const TYPES = { i1: Int8Array, i2: Int16Array, i4: Int32Array, u1: Uint8Array };
const MISSING = { i1: -128, i2: -32768, i4: -2147483648, u1: 255 };

function bytesOf(text) {
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; i++) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

// Bytes of a long text, group by group, so that no second copy of the whole is made on the way.
function blobOf(text, type) {
  const parts = [], group = 1 << 20;
  for (let i = 0; i < text.length; i += group) parts.push(bytesOf(text.slice(i, i + group)));
  return new Blob(parts, { type });
}

// Values as a Float64Array row by row; NaN where one is missing.
async function unpack(content) {
  const stream = new Blob([bytesOf(content.data)]).stream().pipeThrough(new DecompressionStream("deflate"));
  const stored = new TYPES[content.kind](await new Response(stream).arrayBuffer());
  const rows = content.shape[0], columns = rows ? stored.length / rows : 0;
  const values = new Float64Array(stored.length), sum = new TYPES[content.kind](1), missing = MISSING[content.kind];
  for (let column = 0, i = 0; column < columns; column++) {
    sum[0] = 0;
    for (let row = 0; row < rows; row++, i++) {
      sum[0] += stored[i]; // wraps around, as the differences did
      values[row * columns + column] = sum[0] === missing ? NaN : content.start + content.step * sum[0];
    }
  }
  return values;
}

// Replaces every packed array of a record, and of the records in it, by its values.
async function unpackAll(record) {
  const found = Array.isArray(record) ? [] : {};
  for (const [name, value] of Object.entries(record)) {
    const isObject = value !== null && typeof value === "object" && !(Array.isArray(value) && typeof value[0] !== "object");
    found[name] = !isObject ? value : "data" in value && "kind" in value ? await unpack(value) : await unpackAll(value);
  }
  return found;
}
