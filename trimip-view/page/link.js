// The web socket. One request is in flight at a time; of later ones, only the newest waits. The socket is reopened when it breaks.

/** Milliseconds after which a request without an answer counts as lost. */
const LOST = 10000;

/** Pause before the socket is reopened, milliseconds: the first one, and the longest. */
const AGAIN = [300, 5000];

export class Link {
  /**
   * `picture(header, jpeg, milliseconds)` is called with every picture and the time since its request was made, `failed(text)`
   * with every error, `training(run)` with the state of the watched run, `cropped(crop)` with the crop that was kept, and
   * `state(open)` when the socket opens or breaks.
   */
  constructor({ picture, failed, training, cropped, state }) {
    Object.assign(this, { picture, failed, training, cropped, state });
    this.id = 0;
    this.wanted = null;
    this.sent = new Map();
    this.pause = AGAIN[0];
    this.open();
  }

  open() {
    const socket = new WebSocket(new URL("socket", location.href.replace(/^http/, "ws")));
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.pause = AGAIN[0];
      this.state(true);
      this.busy = null;
      if (this.last) this.ask(this.last);
    };
    socket.onmessage = ({ data }) => this.receive(data);
    socket.onclose = () => {
      this.state(false);
      this.socket = null;
      setTimeout(() => this.open(), this.pause);
      this.pause = Math.min(2 * this.pause, AGAIN[1]);
    };
    this.socket = socket;
  }

  receive(data) {
    if (typeof data === "string") {
      const words = JSON.parse(data);
      if (words.training) return this.training(words.training);
      if (words.crop) return this.cropped(words.crop);
      this.busy = null;
      this.failed(words.error);
      return this.flush();
    }
    const length = new DataView(data).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    const jpeg = new Blob([new Uint8Array(data, 4 + length)], { type: "image/jpeg" });
    if (this.busy === header.id) this.busy = null;
    const made = this.sent.get(header.id);
    for (const id of this.sent.keys()) if (id < header.id) this.sent.delete(id);
    // Pictures of a newer state of the model have the number of the last request.
    if (header.done) this.sent.delete(header.id);
    this.picture(header, jpeg, made === undefined ? null : performance.now() - made);
    this.flush();
  }

  /** Requests a view. While an answer is pending, only the newest request is kept. */
  ask(request) {
    this.last = request;
    this.wanted = { ...request, made: performance.now() };
    this.flush();
  }

  /** Sends a command to the run: "pause", "resume" or "stop". */
  command(command) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify({ command }));
  }

  /** Makes a part of the box, given by two corners, the crop of the model. */
  keep(part) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify({ keep: part }));
  }

  flush() {
    const free = this.busy === null || this.busy === undefined || performance.now() - this.since > LOST;
    if (!this.wanted || !free || this.socket?.readyState !== WebSocket.OPEN) return;
    const { made, ...request } = this.wanted;
    this.wanted = null;
    this.id += 1;
    this.busy = this.id;
    this.since = performance.now();
    this.sent.set(this.id, made);
    this.socket.send(JSON.stringify({ id: this.id, ...request }));
  }
}
