// What does the sensor feel? Client.exe [host] [port]. In Unity: examples/stream/README.md.
using System;
using System.IO;
using System.Net.Sockets;
using System.Runtime.Serialization.Json;
using System.Text;

public class Contact { public int[] markers; public double force_N; public double[] position_mm, normal; }
public class Frame { public string type; public long sequence; public bool valid; public double timestamp_s, total_N; public double[] net_force_N, net_moment_Nmm; public Contact[] contacts; }

public static class Client
{
    public static void Main(string[] args)
    {
        var host = args.Length > 0 ? args[0] : "127.0.0.1";
        var port = args.Length > 1 ? int.Parse(args[1]) : 5757;
        var json = new DataContractJsonSerializer(typeof(Frame));
        using (var link = new TcpClient(host, port))
        using (var lines = new StreamReader(link.GetStream(), Encoding.UTF8))
            for (string line; (line = lines.ReadLine()) != null; )
            {
                var frame = (Frame)json.ReadObject(new MemoryStream(Encoding.UTF8.GetBytes(line)));
                if (frame.type != "frame" || !frame.valid) continue;
                foreach (var contact in frame.contacts)
                    Console.WriteLine(FormattableString.Invariant(
                        $"{frame.sequence} {contact.force_N} N at {string.Join(", ", contact.position_mm)}"));
            }
    }
}
