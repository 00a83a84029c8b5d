// The WebSocket: says who this page is, connects anew when it is lost, and matches answers to requests.

const WRONG_TOKEN = 4401;
const TOKEN_KEY = "jpap_token";
const SILENT_AFTER_MS = 5000;
const ANSWER_PATIENCE_MS = 310000;

export class Connection {
  /**
   * @param onMessage called with each snapshot and update
   * @param onState called with "live", "connecting" or "token", and why
   */
  constructor(onMessage, onState) {
    this.onMessage = onMessage;
    this.onState = onState;
    this.token = sessionStorage.getItem(TOKEN_KEY);
    this.waiting = new Map();
    this.number = 0;
    this.delay = 500;
    this.heard = 0;
    // A socket whose other end vanished without a word looks open for minutes.
    setInterval(() => {
      if (this.live && Date.now() - this.heard > SILENT_AFTER_MS) this.#lost("the server is silent");
    }, 1000);
  }

  connect() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/ws`);
    this.socket = socket;
    socket.onopen = () => socket.send(JSON.stringify({ type: "hello", token: this.token }));
    socket.onmessage = (event) => this.#take(JSON.parse(event.data));
    socket.onclose = (event) => {
      if (socket !== this.socket) return;
      if (event.code === WRONG_TOKEN) {
        this.#forget("not connected");
        sessionStorage.removeItem(TOKEN_KEY);
        this.onState("token", event.reason);
      } else this.#lost(event.reason);
    };
  }

  useToken(token) {
    this.token = token;
    sessionStorage.setItem(TOKEN_KEY, token);
    this.connect();
  }

  /** Ask for an action; resolves with the answer, whatever it is. */
  ask(action, fields = {}) {
    if (!this.live) return Promise.resolve({ ok: false, message: "not connected", results: [] });
    const id = ++this.number;
    this.socket.send(JSON.stringify({ type: "request", id, action, ...fields }));
    return new Promise((resolve) => {
      const timer = setTimeout(() => this.#settle(id, { ok: false, message: "no answer", results: [] }), ANSWER_PATIENCE_MS);
      this.waiting.set(id, { resolve, timer });
    });
  }

  #take(message) {
    this.heard = Date.now();
    if (message.type === "answer") {
      this.#settle(message.id, message);
      return;
    }
    if (message.type === "snapshot") {
      this.live = true;
      this.delay = 500;
      this.onState("live", "");
    }
    this.onMessage(message);
  }

  #settle(id, answer) {
    const waiting = this.waiting.get(id);
    if (!waiting) return;
    this.waiting.delete(id);
    clearTimeout(waiting.timer);
    waiting.resolve(answer);
  }

  #forget(why) {
    this.live = false;
    for (const id of [...this.waiting.keys()]) this.#settle(id, { ok: false, message: `connection lost (${why}): see the event log for what came of it`, results: [] });
  }

  #lost(why) {
    const socket = this.socket;
    this.socket = null;
    socket?.close();
    this.#forget(why || "closed");
    this.onState("connecting", why);
    setTimeout(() => this.connect(), this.delay * (0.75 + Math.random() / 2));
    this.delay = Math.min(2 * this.delay, 8000);
  }
}
