// Prints what `torchhand track 0 --out out --live --stream ws://127.0.0.1:9001` sends; runs in Node 22 and, with the
// same lines, in a browser.
const address = globalThis.process?.argv[2] ?? "ws://127.0.0.1:9001";
const socket = new WebSocket(address);

socket.addEventListener("open", () => console.log(`waiting for hands at ${address}`));
socket.addEventListener("close", () => console.log("the tracker has ended"));
socket.addEventListener("message", (event) => {
  const hand = JSON.parse(event.data);
  let line = `${hand.frame} ${hand.status}`;
  if (hand.angles !== null) { // there is a hand in this frame
    const degrees = (180 / Math.PI) * hand.angles.index_pip_fe;
    const [x, y, z] = hand.wrist.position.map((metres) => metres.toFixed(3));
    line += ` index PIP ${degrees.toFixed(0)}°, wrist at ${x} ${y} ${z} m`;
  }
  console.log(line);
});
