// A pipeline's side of `pgti-gtsam gate --socket PATH`. C++17 and POSIX sockets.
//   g++ -std=c++17 -pthread gate_client.cpp -o gate_client && ./gate_client /tmp/gate.sock < map.g2o
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>
#include <iostream>
#include <stdexcept>
#include <string>
#include <thread>

class Gate {
 public:
  explicit Gate(const std::string& path) : socket_(::socket(AF_UNIX, SOCK_STREAM, 0)) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    path.copy(address.sun_path, sizeof(address.sun_path) - 1);
    if (::connect(socket_, reinterpret_cast<sockaddr*>(&address), sizeof(address)) != 0)
      throw std::runtime_error("nobody serves " + path);
  }
  Gate(const Gate&) = delete;
  Gate& operator=(const Gate&) = delete;
  ~Gate() { ::close(socket_); }

  // One line of g2o, or one JSON object, without its line break; false where the gate has gone.
  bool send(const std::string& line) {
    const std::string whole = line + "\n";
    for (size_t sent = 0; sent < whole.size();) {
      const ssize_t n = ::send(socket_, whole.data() + sent, whole.size() - sent, MSG_NOSIGNAL);
      if (n < 0) return false;
      sent += static_cast<size_t>(n);
    }
    return true;
  }

  // No more lines come; answers still do.
  void finish() { ::shutdown(socket_, SHUT_WR); }

  // The next answer; false at the end of them.
  bool receive(std::string& answer) {
    size_t end;
    while ((end = buffer_.find('\n')) == std::string::npos) {
      char bytes[4096];
      const ssize_t n = ::recv(socket_, bytes, sizeof(bytes), 0);
      if (n <= 0) return false;
      buffer_.append(bytes, static_cast<size_t>(n));
    }
    answer = buffer_.substr(0, end);
    buffer_.erase(0, end + 1);
    return true;
  }

 private:
  int socket_;
  std::string buffer_;
};

// What stands behind the first "name": of an answer: text without its quotes, or a number.
std::string field(const std::string& answer, const std::string& name) {
  const std::string label = "\"" + name + "\": ";
  size_t start = answer.find(label), end = start + label.size();
  if (start == std::string::npos) return "";
  if (answer[start = end] != '"') return answer.substr(start, answer.find_first_of(",}", start) - start);
  while (answer[++end] != '"') end += answer[end] == '\\';
  return answer.substr(start + 1, end - start - 1);
}

int main(int, char** words) try {
  Gate gate(words[1] ? words[1] : "/tmp/gate.sock");
  std::thread reader([&gate] {
    for (std::string answer; gate.receive(answer);)
      std::cout << field(answer, "line") << " " << field(answer, "verdict") << field(answer, "error") << std::endl;
  });
  std::string line;
  while (std::getline(std::cin, line) && gate.send(line)) continue;
  gate.finish();
  reader.join();
} catch (const std::exception& error) {
  std::cerr << error.what() << std::endl;
  return 1;
}
